"""``.ci/gpu_figures``: every command that it runs is understood, with the keys that it is given."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from envs.core import arguments
from envs.core.errors import MissingExtraError
from tests.understood import understand

ROOT = Path(__file__).parents[1]
STEPS = (
    *("processes", "collection", "vla", "table", "shifts", "nuts", "nuts_quick", "level3", "new_looks"),
    *("nuts_diffusion", "hold_diffusion", "ppo_rgb", "h1hand"),
    *("generated", "corrections", "multi_task", "wording", "grasp", "grasp_vla"),
    *("libero", "libero_places", "calvin", "axes"),
)
PYTHON = """#!{python}
import json, sys
with open({log!r}, "a") as log:
    log.write(json.dumps(sys.argv[1:]) + "\\n")
"""


def run(folder: Path, *steps: str, **env: str) -> subprocess.CompletedProcess[str]:
    """Runs steps with a Python that only notes its words, in ``folder/log``."""
    python = folder / "python"
    python.write_text(PYTHON.format(python=sys.executable, log=str(folder / "log")))
    python.chmod(0o755)
    env = {**os.environ, "PYTHON": str(python), "FIGURES": str(folder / "figures"), **env}
    return subprocess.run(
        [ROOT / ".ci/gpu_figures", *steps], env=env, capture_output=True, text=True, check=False
    )


def words_of(folder: Path) -> list[list[str]]:
    return [json.loads(line) for line in (folder / "log").read_text().splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize("step", STEPS)
def test_a_steps_commands_are_understood(step: str, tmp_path: Path) -> None:
    done = run(tmp_path, step, TEXT_ENCODER=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"=== {step}\n"
    commands = words_of(tmp_path)
    assert commands
    for _, module, *words in commands:
        if module != "roboverse_learn":
            check_program(module, words)
            continue
        name, *settings = words
        settings = [word for word in settings if "=" in word and not word.startswith("run=")]
        try:
            understand(name, settings)
        except MissingExtraError:
            continue  # of a task whose assets are optional


def check_program(module: str, words: list[str]) -> None:
    if module == "roboverse_learn.training.imitation.small_backbone":
        from roboverse_learn.training.imitation.small_backbone import BackboneSettings as Settings
    elif module == "envs.randomization.new_materials":
        from envs.randomization.new_materials import NewMaterialsSettings as Settings
    else:
        assert module == "roboverse_learn.teleoperation.correction_study"
        from roboverse_learn.teleoperation.correction_study import StudySettings as Settings

        words = [word for word in words if word.startswith("out=")]  # the others are of train
    arguments.parse(module, Settings, words)


@pytest.mark.slow
@pytest.mark.parametrize("step", ["nuts", "level3", "libero_places"])
def test_every_change_that_a_study_tries_changes_its_recipe(step: str, tmp_path: Path) -> None:
    assert run(tmp_path, step).returncode == 0
    recipes = [path.read_text() for path in (tmp_path / "figures").glob(f"{step}_*.yaml")]
    assert len(recipes) > 5 and len(set(recipes)) == len(recipes)


@pytest.mark.slow
def test_all_steps_are_those_that_are_tested(tmp_path: Path) -> None:
    done = run(tmp_path, "nothing")
    assert done.returncode == 2
    assert done.stderr == f"'nothing' is no step. Steps: {' '.join(STEPS)}.\n"


def test_without_a_text_encoder_its_step_says_what_it_needs(tmp_path: Path) -> None:
    done = run(tmp_path, "wording", TEXT_ENCODER="")
    assert done.returncode == 0 and "TEXT_ENCODER=<folder of a BERT-like model>" in done.stderr
    assert not (tmp_path / "log").exists()
