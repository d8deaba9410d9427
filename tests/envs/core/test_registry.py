"""Registration: names, lazy targets, and what other packages add through entry points and plugins."""

import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError
from envs.core.extras import install_command
from envs.core.registry import (
    PLUGINS_VARIABLE,
    Registry,
    leave_out_broken_plugins,
    load_plugins,
    registered_by_hand,
)

GROUP = "roboverse.test_things"


def install(folder, monkeypatch, name, points, modules=()):
    """Puts a package with these entry points into ``folder``, as an installer would."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    info.joinpath("METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = "\n".join(f"{key} = {value}" for key, value in points.items())
    info.joinpath("entry_points.txt").write_text(f"[{GROUP}]\n{lines}\n")
    for module, text in dict(modules).items():
        folder.joinpath(f"{module}.py").write_text(text)
        monkeypatch.delitem(sys.modules, module, raising=False)
    monkeypatch.syspath_prepend(folder)
    importlib.invalidate_caches()


def test_entry_points_of_other_packages_are_registered_and_imported_on_use(tmp_path, monkeypatch):
    modules = {"their_things": "THING = 42\n"}
    install(tmp_path, monkeypatch, "theirs", {"Theirs": "their_things:THING"}, modules)
    registry = Registry("thing", GROUP)
    registry.add("Ours", 1)
    assert registry.names() == ["Ours", "Theirs"]
    assert "their_things" not in sys.modules
    assert registry.get("Theirs") == 42
    assert registry.entry("Theirs").distribution == "theirs"


def test_a_name_of_two_packages_is_refused_where_it_is_used_and_nowhere_else(tmp_path, monkeypatch):
    one, other = {"Both": "one_things:THING"}, {"Both": "other_things:THING", "Free": "json:loads"}
    install(tmp_path / "one", monkeypatch, "one", one)
    install(tmp_path / "other", monkeypatch, "other", other)
    registry = Registry("thing", GROUP)
    registry.add("Ours", 1)
    assert registry.names() == ["Both", "Free", "Ours"] and "Both" in registry
    assert registry.get("Ours") == 1 and registry.get("Free") is json.loads
    assert registry.entry("Both").summary in ("from one", "from other")
    both = r"'Both' is registered by the package '(\w+)' \(\1_things:THING\), and by the package '(?!\1)"
    for _ in range(2):
        with pytest.raises(ConfigError, match=both + r".*another name.*'roboverse.test_things'"):
            registry.get("Both")
    assert [re.search(both, said) is not None for said in registry.conflicts()] == [True]


@pytest.mark.parametrize(
    ("module", "who"), [("policies", "RoboVerse Learn itself"), ("my_script", "the module 'my_script'")]
)
def test_a_package_that_takes_a_name_from_us_or_a_module_is_named_with_it(tmp_path, monkeypatch, module, who):
    install(tmp_path, monkeypatch, "theirs", {"Ours": "their_things:THING"})
    registry = Registry("thing", GROUP)
    exec("add('Ours', 1)", {"__name__": module, "add": registry.add})
    assert registry.names() == ["Ours"]
    with pytest.raises(ConfigError, match=rf"'Ours' is registered by {who}, and by the package 'theirs'"):
        registry.get("Ours")


def test_a_plugin_may_take_the_name_of_an_installed_package_until_it_is_used(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "theirs", {"Theirs": "json:loads"})
    registry = Registry("thing", GROUP)
    assert registry.get("Theirs") is json.loads
    exec("add('Theirs', 'mine:THING')", {"__name__": "mine", "add": registry.add})
    with pytest.raises(ConfigError, match=r"by the package 'theirs' .*and by the module 'mine' \(mine:THING"):
        registry.get("Theirs")


def test_an_entry_point_that_cannot_be_imported_names_its_package(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "theirs", {"Theirs": "no_such_module:THING"})
    with pytest.raises(ConfigError, match=r"'Theirs' of the package 'theirs'.*no_such_module"):
        Registry("thing", GROUP).get("Theirs")


@pytest.mark.parametrize(
    "body", ["raise ValueError('bad gain')", "open('no_such_file')", "raise SystemExit(0)"]
)
def test_an_entry_point_that_fails_at_import_names_its_package_and_the_error(tmp_path, monkeypatch, body):
    install(tmp_path, monkeypatch, "theirs", {"Theirs": "failing_things:THING"}, {"failing_things": body})
    with pytest.raises(
        ConfigError, match=r"'Theirs' of the package 'theirs'.*python -c 'import failing_things'"
    ):
        Registry("thing", GROUP).get("Theirs")


@pytest.fixture
def block(tmp_path, monkeypatch):
    """A package that registers ``Block`` when it is imported, as ``roboverse new`` writes it."""
    registry = Registry("thing", GROUP)
    monkeypatch.setattr("builtins.registry", registry, raising=False)
    folder = tmp_path / "block"
    folder.mkdir()
    folder.joinpath("__init__.py").write_text(
        "import builtins\nbuiltins.registry.add('Block', 'block.thing:Block')\n"
    )
    folder.joinpath("thing.py").write_text("class Block: ...\nclass Other: ...\n")
    yield registry
    for name in ("block", "block.thing"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("target", "cause"),
    [
        ("block.thng:Block", "from 'block.thng:Block': No module named 'block.thng'. Mend its entry point"),
        ("block.thing:BLock", "has no attribute 'BLock'. Did you mean 'Block'? Mend its entry point"),
        (
            "block.thing:Other",
            "by the package 'block' (block.thing:Other), and by the module 'block' (block.",
        ),
    ],
)
def test_an_entry_point_that_differs_from_what_its_package_registers_says_what_is_wrong_with_it(
    tmp_path, monkeypatch, block, target, cause
):
    install(tmp_path, monkeypatch, "block", {"Block": target, "Fine": "block.thing:Other"})
    for _ in range(2):
        with pytest.raises(ConfigError, match=re.escape(cause)) as caught:
            block.get("Block")
        assert ".." not in str(caught.value)
    assert block.get("Fine").__name__ == "Other"


def test_an_error_that_ends_with_a_full_stop_has_no_second_one(tmp_path, monkeypatch):
    modules = {"stopping_things": "raise ValueError('Bad gain.')"}
    install(tmp_path, monkeypatch, "theirs", {"Theirs": "stopping_things:THING"}, modules)
    with pytest.raises(ConfigError, match=r"ValueError: Bad gain\. Mend stopping_things;"):
        Registry("thing", GROUP).get("Theirs")
    monkeypatch.setenv(PLUGINS_VARIABLE, "stopping_things")
    with pytest.raises(ConfigError, match=r"ValueError: Bad gain\. Mend it;"):
        Registry("thing", GROUP).names()


def test_plugins_register_by_being_imported(tmp_path, monkeypatch):
    tmp_path.joinpath("my_plugin.py").write_text("import builtins\nbuiltins.registry.add('Mine', 7)\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry = Registry("thing", GROUP)
    monkeypatch.setattr("builtins.registry", registry, raising=False)
    monkeypatch.setenv(PLUGINS_VARIABLE, "my_plugin")
    assert registry.get("Mine") == 7


def test_a_plugin_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setenv(PLUGINS_VARIABLE, "no_such_plugin")
    with pytest.raises(ConfigError, match=r"The plugin 'no_such_plugin' cannot be imported.*PYTHONPATH"):
        Registry("thing", GROUP).names()


@pytest.mark.parametrize(
    "body", ["raise ValueError('bad gain')", "open('no_such_file')", "raise SystemExit(0)"]
)
def test_a_plugin_that_fails_at_import_is_named_with_its_error(tmp_path, monkeypatch, body):
    tmp_path.joinpath("failing_plugin.py").write_text(body)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "failing_plugin")
    with pytest.raises(ConfigError, match=r"The plugin 'failing_plugin'.*python -c 'import failing_plugin'"):
        Registry("thing", GROUP).names()


def test_a_plugin_that_raises_an_error_of_ours_shows_its_words(tmp_path, monkeypatch):
    body = "from envs.core.errors import ConfigError\nraise ConfigError('Set MY_FILES first.')\n"
    tmp_path.joinpath("speaking_plugin.py").write_text(body)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "speaking_plugin")
    with pytest.raises(ConfigError, match=r"^Set MY_FILES first\.$"):
        Registry("thing", GROUP).names()


def test_after_a_plugin_that_failed_the_next_reader_sees_the_same_error_and_then_everything(
    tmp_path, monkeypatch
):
    install(tmp_path, monkeypatch, "theirs", {"Their": "json:loads"})
    monkeypatch.setenv(PLUGINS_VARIABLE, "plugin_of_nobody")
    registry = Registry("thing", GROUP)
    for _ in range(2):
        with pytest.raises(ConfigError, match="'plugin_of_nobody' cannot be imported"):
            registry.names()
    monkeypatch.setenv(PLUGINS_VARIABLE, "")
    assert registry.names() == ["Their"]


def test_names_of_other_plugins_and_packages_are_there_beside_a_plugin_that_failed(tmp_path, monkeypatch):
    install(tmp_path, monkeypatch, "theirs", {"Their": "json:loads"})
    tmp_path.joinpath("later_plugin.py").write_text("import builtins\nbuiltins.registry.add('Mine', 7)\n")
    monkeypatch.setenv(PLUGINS_VARIABLE, "plugin_of_nobody,later_plugin")
    registry = Registry("thing", GROUP)
    monkeypatch.setattr("builtins.registry", registry, raising=False)
    registry.add("Ours", 1)
    with pytest.raises(ConfigError, match="'plugin_of_nobody' cannot be imported"):
        registry.names()
    assert registry.names_so_far() == ["Mine", "Ours", "Their"]


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("lift_blok", "lift_block.py"),
        ("lift_blok.task", "lift_block/__init__.py"),
        ("lift_blok", "lift_block/lift_block.py"),
        ("lift_blok", "lift_block/lift_block/__init__.py"),
        ("lift_block.py", "lift_block.py"),
    ],
)
def test_a_plugin_whose_name_is_misspelt_suggests_the_nearest(tmp_path, monkeypatch, name, file):
    path = tmp_path / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setenv(PLUGINS_VARIABLE, name)
    with pytest.raises(ConfigError, match=r"No module named .*\. Did you mean 'lift_block'\? Install it"):
        load_plugins()
    sys.modules.pop("lift_block", None)


def test_a_module_that_a_package_lacks_suggests_no_other_plugin(tmp_path, monkeypatch):
    (tmp_path / "lift_block").mkdir()
    (tmp_path / "lift_block/__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "lift_block.tsk")
    with pytest.raises(ConfigError, match=r"No module named 'lift_block\.tsk'\. Install it"):
        load_plugins()
    sys.modules.pop("lift_block", None)


def test_a_package_that_a_plugin_lacks_suggests_no_other_plugin(tmp_path, monkeypatch):
    tmp_path.joinpath("push_things.py").write_text("import push_thing\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(PLUGINS_VARIABLE, "push_things")
    with pytest.raises(ConfigError, match=r"No module named 'push_thing'\. Install it"):
        load_plugins()


def test_plugins_that_fail_are_left_out_and_the_others_are_imported(tmp_path, monkeypatch):
    tmp_path.joinpath("plugin_that_works.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("envs.core.registry._LEFT_OUT", {})
    monkeypatch.setenv(PLUGINS_VARIABLE, "plugin_of_nobody,plugin_that_works")
    for _ in range(2):
        said = leave_out_broken_plugins()
        assert list(said) == ["plugin_of_nobody"]
        assert said["plugin_of_nobody"].endswith("The environment variable ROBOVERSE_PLUGINS names it.")
        assert "plugin_that_works" in sys.modules and os.environ[PLUGINS_VARIABLE] == "plugin_that_works"
    sys.modules.pop("plugin_that_works")


def test_unknown_name_suggests_nearest():
    registry = Registry("thing")
    registry.add("PickCube", 1)
    with pytest.raises(UnknownNameError, match=r"Unknown thing 'PickCub'\. Did you mean 'PickCube'\?"):
        registry.get("PickCub")


@pytest.mark.parametrize(
    ("given", "meant"),
    [("dif", "diffusion"), ("usi", "diffusion"), ("act", "actor"), ("actro", "actor"), ("panda", "franka")],
)
def test_a_part_of_a_name_and_a_name_of_others_suggest_it(given, meant):
    registry = Registry("thing", other_names={"panda": "franka"})
    for name in (
        "dif_of_many_parts",
        "a_dif",
        "diffusion",
        "reactor",
        "actor",
        "act_twice",
        "franka",
        "two_panda",
    ):
        registry.add(name, 1)
    with pytest.raises(UnknownNameError, match=rf"Unknown thing '{given}'\. Did you mean '{meant}'\?"):
        registry.get(given)


def test_two_letters_suggest_no_name_that_holds_them():
    registry = Registry("thing")
    registry.add("diffusion", 1)
    with pytest.raises(UnknownNameError, match=r"Unknown thing 'us'\. Valid: diffusion"):
        registry.get("us")


def test_missing_package_names_the_extra_to_install():
    registry = Registry("thing")
    registry.add("x", "no_such_module:X", extra="things")
    with pytest.raises(MissingExtraError, match=re.escape(install_command("things"))):
        registry.get("x")


class Thing:
    """Something to register."""


def test_the_same_target_may_be_registered_again_and_another_may_not(tmp_path, monkeypatch):
    """A module that registers itself and has an entry point, too, is installed and named as a plugin."""
    install(tmp_path, monkeypatch, "theirs", {"Mine": f"{__name__}:Thing"})
    for first, second in ((Thing, f"{__name__}:Thing"), (f"{__name__}:Thing", Thing), (Thing, Thing)):
        registry = Registry("thing", GROUP)
        registry.add("Mine", first, summary="first")
        registry.add("Mine", second)
        assert registry.names() == ["Mine"] and registry.entry("Mine").summary == "first"
        with pytest.raises(ValueError, match="The thing 'Mine' is registered already"):
            registry.add("Mine", "others:Thing")


def test_names_that_a_script_registers_are_distinguished_from_those_of_plugins(tmp_path, monkeypatch):
    things = Registry("thing")
    things.add("ByHand", "collections:OrderedDict")
    things.decorate("Decorated")(type("Decorated", (), {}))
    (tmp_path / "my_plugin_of_things.py").write_text(
        "def add(things):\n    things.add('ByPlugin', 'json:loads')\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("my_plugin_of_things").add(things)
    assert {"ByHand", "Decorated", "ByPlugin"} <= set(registered_by_hand())
    monkeypatch.setenv(PLUGINS_VARIABLE, "other,my_plugin_of_things.tasks")
    names = set(registered_by_hand())
    assert {"ByHand", "Decorated"} <= names and "ByPlugin" not in names


def test_what_this_package_registers_is_known_to_every_process():
    code = (
        "import envs.tasks.suites, roboverse_learn.data.sources, policies, envs.simulators\n"
        "from envs.core.registry import registered_by_hand\n"
        "assert registered_by_hand() == []"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[3])
