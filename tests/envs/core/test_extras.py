import shlex

import pytest

from envs.core import extras
from envs.core.extras import install_command

PINNED = "uv pip install -c constraints.txt --override overrides.txt"


@pytest.mark.parametrize("extra", ["viewer", "libero"])
def test_in_a_checkout_an_extra_is_installed_with_its_pins_as_the_readme_does(monkeypatch, extra):
    monkeypatch.chdir(extras._CHECKOUT)
    command = install_command(extra)
    assert command == f"{PINNED} -e '.[{extra}]'"
    readme = (extras._CHECKOUT / "README.md").read_text()
    assert command.replace(extra, "docs") in readme


def test_in_another_folder_the_command_names_the_files_of_the_checkout(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    root = extras._CHECKOUT
    words = ["-c", f"{root}/constraints.txt", "--override", f"{root}/overrides.txt", "-e", f"{root}[viewer]"]
    assert install_command("viewer") == shlex.join(["uv", "pip", "install", *words])


def test_an_extra_of_a_wheel_is_installed_with_the_overrides_where_its_packages_pin_old_ones(
    monkeypatch, tmp_path
):
    monkeypatch.setattr(extras, "_CHECKOUT", tmp_path)  # without pyproject.toml, as site-packages are
    assert install_command("viewer") == "pip install 'roboverse-learn[viewer]'"
    assert install_command("libero") == f"{PINNED} 'roboverse-learn[libero]'"
