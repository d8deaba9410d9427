"""The way between Meta-World's environments and our scenarios and states."""

import re
import sys

import mujoco
import numpy as np
import pytest
import torch

from envs.core.extras import install_command

pytest.importorskip("metaworld")

import metaworld

from envs.core.errors import MissingExtraError
from envs.mjcf.model import build_model
from envs.tasks import TASKS
from envs.tasks.metaworld.catalogue import PREFIX, VERSION, WORDS
from envs.tasks.metaworld.original import Original
from envs.tasks.metaworld.task import MetaWorldTask

# A drawer (jointed, fixed), a nut (free), a mug (free) with a machine, a plate on two slides, a dial.
SCENES = (
    "DrawerOpen",
    "metaworld/assembly",
    "metaworld/coffee-push",
    "metaworld/plate-slide",
    "metaworld/dial-turn",
)


@pytest.fixture(scope="module", params=SCENES)
def task(request):
    return TASKS.get(request.param)()


def rngs(count):
    return [np.random.default_rng(row) for row in range(count)]


def test_there_are_meta_worlds_fifty_tasks():
    own = {TASKS.get(name).original_name for name in TASKS.names("metaworld")}
    assert own == set(metaworld.ALL_V3_ENVIRONMENTS)
    assert TASKS.names("adapted") == sorted(f"{PREFIX}{name}" for name in WORDS)
    assert len(WORDS) == 45
    assert all(len(set(words)) == len(words) >= 2 for words in WORDS.values())


def test_a_task_is_made_once_and_has_its_name():
    reach = TASKS.get("metaworld/reach")
    assert TASKS.get("metaworld/reach") is reach
    assert (reach.name, reach.original_name) == ("metaworld/reach", f"reach{VERSION}")
    assert issubclass(reach, MetaWorldTask)
    with pytest.raises(AttributeError, match="has no attribute 'raech'"):
        from envs.tasks.metaworld import others

        others.raech  # noqa: B018


@pytest.mark.parametrize("name", ["DrawerOpen", "metaworld/reach"])
def test_missing_metaworld_names_the_install_command(name, monkeypatch):
    for module in list(sys.modules):
        if module.startswith("envs.tasks.metaworld.") and not module.endswith("catalogue"):
            monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "metaworld", None)
    needed = f"the package 'metaworld'.*{re.escape(install_command('metaworld'))}"
    with pytest.raises(MissingExtraError, match=needed):
        TASKS.get(name)


@pytest.mark.slow
def test_the_physics_is_the_files(task):
    ours, theirs = build_model(task.scenario), task.original.model
    ids = {ours.body(i).name.rpartition("/")[2]: i for i in range(ours.nbody)}
    for index in range(1, theirs.nbody):
        name = theirs.body(index).name
        if name in ids and name != "mocap":
            np.testing.assert_allclose(ours.body_mass[ids[name]], theirs.body_mass[index], err_msg=name)
            np.testing.assert_allclose(ours.body_inertia[ids[name]], theirs.body_inertia[index], err_msg=name)
    for name in ("timestep", "integrator", "cone", "impratio", "jacobian", "iterations", "tolerance"):
        assert getattr(ours.opt, name) == getattr(theirs.opt, name), name
    assert ours.nq == theirs.nq
    for name in ("dof_damping", "dof_armature", "dof_frictionloss", "jnt_stiffness"):
        np.testing.assert_allclose(np.sort(getattr(ours, name)), np.sort(getattr(theirs, name)), err_msg=name)
    np.testing.assert_array_equal(ours.actuator_gainprm[:, 0], theirs.actuator_gainprm[:, 0])
    np.testing.assert_array_equal(ours.actuator_ctrlrange, theirs.actuator_ctrlrange)
    weld = theirs.eq_type == int(mujoco.mjtEq.mjEQ_WELD)
    np.testing.assert_array_equal(np.abs(ours.eq_data[:, :11]), np.abs(theirs.eq_data[weld, :11]))


def test_states_and_meta_worlds_poses_say_the_same(task):
    vectors = np.stack([task.original.draw(rng) for rng in rngs(3)])
    episodes = [task.original.episode(vector) for vector in vectors]
    goals = np.stack([episode.goal for episode in episodes])
    state = task.scene.state([episode.start for episode in episodes], goals, vectors)
    poses, back = task.scene.poses(state)
    np.testing.assert_array_equal(back, vectors)
    for pose, episode in zip(poses, episodes, strict=True):
        for name in ("qpos", "qvel", "ctrl", "mocap_pos", "body_pos"):
            np.testing.assert_array_equal(getattr(pose, name), getattr(episode.start, name), err_msg=name)
    np.testing.assert_array_equal(state.objects["goal"].pos, goals)


def test_an_episode_leaves_no_trace_in_the_next(task):
    fresh, used = Original(task.original_name), Original(task.original_name)
    first, second = (fresh.draw(rng) for rng in rngs(2))
    used.evaluate(first, used.episode(first).start)
    seen = [env.evaluate(second, env.episode(second).start) for env in (fresh, used)]
    np.testing.assert_array_equal(seen[0][0], seen[1][0])
    assert seen[0][1:] == seen[1][1:]
    np.testing.assert_array_equal(fresh.episode(second).start.qpos, used.episode(second).start.qpos)


def test_initial_states_are_in_meta_worlds_space(task):
    space = task.original.env._random_reset_space
    vectors = np.stack([task.original.draw(rng) for rng in rngs(20)])
    assert (vectors >= space.low).all() and (vectors <= space.high).all()
    assert len(np.unique(vectors, axis=0)) == 20


def test_asking_changes_no_state_and_needs_no_order(task):
    state = task.initial_state(rngs(3))
    before = {key: value.clone() for key, value in state.flatten().items()}
    together = task._answers(state)
    alone = [task._answers(state.select([row])) for row in (2, 0, 1)]
    for whole, parts in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(whole[[2, 0, 1]], np.concatenate(parts))
    assert all(torch.equal(value, before[key]) for key, value in state.flatten().items())


def test_states_that_are_not_finite_are_not_evaluated(task):
    state = task.initial_state(rngs(2))
    state.robots["sawyer"].joint_pos[0] = torch.nan
    seen, rewards, successes = MetaWorldTask._answers(task, state)
    assert np.isnan(seen[0]).all()
    assert np.isfinite(seen[1]).all()
    assert (rewards[0], bool(successes[0])) == (0.0, False)
