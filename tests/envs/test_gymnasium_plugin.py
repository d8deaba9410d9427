"""The plugin of Gymnasium: its ids without an import, in a process and a folder as a user has them."""

import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

PLUGIN = Path(__file__).resolve().parents[2] / "envs" / "gymnasium_plugin"


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Runs Python in a folder, after it has read the plugin's .pth file as it does at its start."""
    start = f"import site, sys\nsite.addsitedir({str(PLUGIN)!r})\n"
    path = os.pathsep.join(dict.fromkeys(entry for entry in sys.path if entry))
    return subprocess.run(
        [sys.executable, "-c", start + code],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.parametrize("beside", ["nothing", "a folder envs without a package"])
def test_gymnasium_makes_a_task_without_a_prefix_and_without_an_import(beside, tmp_path):
    if beside != "nothing":
        (tmp_path / "envs").mkdir()
        (tmp_path / "envs" / "notes.txt").write_text("conda environments")
    code = (
        "import gymnasium\n"
        "assert 'envs' not in sys.modules\n"
        "env = gymnasium.make('RoboVerse/PickCube-v0', observation='state')\n"
        "print(env.reset(seed=0)[0]['agent_pos'].shape, env.spec.id)\n"
        "print(gymnasium.make_vec('RoboVerse/PickCube-state-v0', num_envs=2).num_envs)\n"
        "print(gymnasium.spec('RoboVerse/metaworld-reach-v0').kwargs['task'])\n"
    )
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:3] == ["(9,) RoboVerse/PickCube-v0", "2", "metaworld/reach"]


def test_a_package_envs_of_the_working_directory_is_named_as_what_hides_ours(tmp_path):
    (tmp_path / "envs").mkdir()
    (tmp_path / "envs" / "__init__.py").write_text("raise RuntimeError('not ours to import')\n")
    done = run("import gymnasium\ngymnasium.make(id='RoboVerse/PickCube-v0')\n", tmp_path)
    assert done.returncode == 1
    said = done.stderr.splitlines()[-1]
    assert said.startswith(f"ImportError: {tmp_path / 'envs' / '__init__.py'} hides the package envs"), said
    assert "Rename it, or run the program from another folder." in said


def test_a_module_envs_is_named_as_what_hides_ours(tmp_path):
    (tmp_path / "envs.py").write_text("")
    done = run("import gymnasium\ngymnasium.spec('RoboVerse/PickCube-v0')\n", tmp_path)
    assert f"ImportError: {tmp_path / 'envs.py'} hides the package envs" in done.stderr


def test_other_ids_and_other_programs_import_nothing_of_ours(tmp_path):
    code = (
        "loaded = set(sys.modules)\n"
        "assert not {'gymnasium', 'numpy', 'envs'} & loaded\n"
        "import gymnasium\n"
        "env = gymnasium.make('CartPole-v1')\n"
        "assert not [name for name in sys.modules if name.partition('.')[0] == 'envs']\n"
        "assert 'roboverse_gymnasium' not in [getattr(f, '__module__', '') for f in sys.meta_path]\n"
        "gymnasium.make('RoboVers/PickCube-v0')\n"
    )
    done = run(code, tmp_path)
    assert "NamespaceNotFound: Namespace RoboVers not found." in done.stderr, done.stderr


def test_a_task_that_is_not_there_is_gymnasiums_error_with_the_nearest(tmp_path):
    done = run("import gymnasium\ngymnasium.make('RoboVerse/PickCub-v0')\n", tmp_path)
    assert "Did you mean: `PickCube`?" in done.stderr, done.stderr


def test_its_distribution_holds_the_module_and_the_line_that_imports_it():
    project = tomllib.loads((PLUGIN / "pyproject.toml").read_text())
    name = project["project"]["name"]
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["include"] == [f"{name}.py"] and wheel["force-include"] == {f"{name}.pth": f"{name}.pth"}
    assert (PLUGIN / f"{name}.pth").read_text() == f"import {name}\n"
