from envs.core.extras import install_command


def test_an_extra_whose_packages_pin_old_ones_is_installed_with_the_overrides():
    assert install_command("viewer") == "pip install 'roboverse-learn[viewer]'"
    pinned = install_command("libero")
    assert pinned == "uv pip install -c constraints.txt --override overrides.txt 'roboverse-learn[libero]'"
