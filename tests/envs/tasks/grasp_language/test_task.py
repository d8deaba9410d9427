"""Grasping by language: the named object alone counts, and the instruction alone says which it is."""

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError
from envs.randomization import channel_rng
from envs.tasks import TASKS
from envs.tasks.grasp_language.catalogue import entries
from envs.tasks.wrong_instructions import wrong_instructions

NAME = "grasp/few/ketchup"


@pytest.fixture(scope="module")
def task():
    made = TASKS.get(NAME)()
    try:
        made.initial_state([channel_rng(0, "task", 0)])  # reads the objects' files
    except MissingExtraError as error:
        pytest.skip(str(error))
    return made


@pytest.fixture
def held(task):
    """A state in which the ketchup is held up by closing fingers that are kept apart."""
    state = task.initial_state([channel_rng(0, "task", 0)])
    robot, ketchup = state.robots[task.robot.name], state.objects["ketchup"]
    ketchup.pos[:, 2] += 0.12
    robot.ee_pos = ketchup.pos + torch.tensor([0.0, 0.0, 0.03])
    robot.joint_target = robot.joint_pos.clone()
    robot.joint_target[:, list(task.robot.fingers)] = 0.0
    robot.joint_pos[:, list(task.robot.fingers)] = 0.018
    return state


def test_the_named_object_held_high_is_a_success(task, held):
    assert task.success(held).tolist() == [True]
    assert 0.9 < float(task.reward(held)) < 1.0


@pytest.mark.parametrize(
    "change",
    [
        lambda s, r: s.objects["ketchup"].pos[:, 2].sub_(0.03),
        lambda s, r: s.objects["milk"].pos[:, 2].add_(0.04),
        lambda s, r: r.ee_pos.sub_(0.2),
        lambda s, r: r.joint_pos[:, -2:].fill_(0.0),
        lambda s, r: r.joint_target[:, -2:].fill_(0.04),
        lambda s, r: s.objects["ketchup"].pos.fill_(float("nan")),
        lambda s, r: s.objects["milk"].pos.fill_(float("nan")),
    ],
    ids=["too low", "another one too", "far hand", "empty fingers", "open hand", "not finite", "milk lost"],
)
def test_anything_else_is_none(task, held, change):
    change(held, held.robots[task.robot.name])
    assert task.success(held).tolist() == [False]


def test_success_is_the_same_of_arrays(task, held):
    assert task.success(held.arrays()).tolist() == [True]
    assert np.allclose(task.reward(held.arrays()), task.reward(held))
    assert np.allclose(task.observe(held.arrays()), task.observe(held))


def test_objects_stand_apart_upright_and_on_the_table(task):
    from envs.tasks.grasp_language.scene import objects_of
    from envs.tasks.skills.clouds import cloud

    state = task.initial_state([channel_rng(0, "task", i) for i in range(4)])
    clouds = {
        name: cloud(item.parts, state.objects[name].select(torch.tensor([0])))
        for name, item in objects_of("few").items()
    }
    lowest = [points[:, 2].min() for points in clouds.values()]
    assert np.abs(lowest).max() < 2e-3
    assert clouds["ketchup"][:, 2].max() > 0.12 and clouds["milk"][:, 2].max() > 0.1, "they stand upright"
    for first, points in clouds.items():
        for second, others in clouds.items():
            if first < second:
                away = np.linalg.norm(points[:, None, :2] - others[None, :, :2], axis=-1)
                assert away.min() > task.gap_m, (first, second)


def test_the_tasks_of_a_set_have_one_scene_and_one_start(task):
    other = TASKS.get("grasp/few/milk")()
    assert other.scenario == task.scenario
    rngs = [[channel_rng(0, "task", 3)] for _ in range(2)]
    first, second = (one.initial_state(rng).flatten() for one, rng in zip((task, other), rngs, strict=True))
    assert all(torch.equal(value, second[key]) for key, value in first.items())


def test_wrong_instructions_name_the_other_objects_of_the_scene(task):
    assert set(task.same_scene_tasks()) == {
        name for name, entry in entries().items() if entry.set == "few" and entry.target != "ketchup"
    }
    assert "grasp the milk" in wrong_instructions(task)
    assert not any("ketchup" in words for words in wrong_instructions(task))


def test_an_expert_without_any_grasp_gives_up(task, monkeypatch):
    monkeypatch.setattr("envs.tasks.grasp_language.task.top_grasps", lambda *args: [])
    state = task.initial_state([channel_rng(0, "task", 0)])
    assert task.expert(state, np.random.default_rng(0)) == []


def test_a_class_that_is_none_is_an_attribute_error():
    try:
        from envs.tasks.grasp_language import by_name
    except MissingExtraError as error:
        pytest.skip(str(error))
    with pytest.raises(AttributeError, match="GraspFewNothing"):
        _ = by_name.GraspFewNothing
