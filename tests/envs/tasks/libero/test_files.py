"""Files of the extra ``libero``, and what is said where it is absent or damaged."""

import numpy as np
import pytest

from docs.generate.libero_catalogue import catalogue_text
from envs.core.errors import ConfigError, MissingExtraError
from envs.spec import EnvSpec
from envs.tasks.libero import files, task
from envs.tasks.libero.catalogue import CATALOGUE, entries
from envs.tasks.libero.scene import scene_of
from envs.tasks.libero.start_files import fixed_starts
from envs.tasks.libero_objects import read_init_states

NAME = "libero/object/pick_up_the_milk_and_place_it_in_the_basket"


@pytest.fixture
def entry():
    entry = entries()[NAME]
    try:
        files.problem_file(entry)
    except MissingExtraError as error:
        pytest.skip(str(error))
    return entry


def test_without_the_extra_a_task_says_how_to_install_it(monkeypatch):
    def absent(reference):
        raise MissingExtraError(reference)

    monkeypatch.setattr(files, "resolve", absent)
    for cached in (scene_of, task._scenario_of, task._goal_of):
        cached.cache_clear()
    with pytest.raises(MissingExtraError, match=r"the package 'libero', which is not installed.*\[libero\]"):
        EnvSpec(task=NAME).make()


def test_the_catalogue_is_that_of_the_installed_task_files(entry):
    assert CATALOGUE.read_text(encoding="utf-8") == catalogue_text(), (
        "python -m docs.generate.libero_catalogue"
    )


def test_start_states_of_another_width_are_refused(entry):
    path = files.start_file(entry)
    with pytest.raises(ConfigError, match=r"milk.*\.pruned_init: its initial states are 50 × 110 numbers"):
        read_init_states(path, 111)


@pytest.mark.slow
def test_start_states_are_in_the_order_of_the_task_file(entry):
    """The milk hangs in the middle of its region, (-0.0 ± 0.025, …), and the fingers' signs are ours."""
    scene = scene_of(entry)
    starts = fixed_starts(entry, scene)
    assert starts.num_envs == 50
    assert (starts.robots[scene.robot.name].joint_pos[:, 7:] > 0).all()
    for atom in scene.problem.init:
        region = scene.problem.regions[atom.args[1]]
        assert region.ranges is not None
        x0, y0, x1, y1 = region.ranges
        x, y = starts.objects[atom.args[0]].pos[:, :2].numpy().T
        assert ((x > x0 - 0.02) & (x < x1 + 0.02) & (y > y0 - 0.02) & (y < y1 + 0.02)).all(), atom
    assert np.isfinite(starts.objects["milk_1"].rot.numpy()).all()
