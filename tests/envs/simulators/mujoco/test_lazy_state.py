"""States whose fields are made when they are read."""

import numpy as np
import pytest
import torch

import envs


@pytest.fixture
def robot():
    env = envs.make_vec("PickCube", 2, observation="state")
    env.reset(seed=0)
    state = env.handler.get_states([0, 1])
    yield state.robots["franka"]
    env.close()


def test_a_field_is_a_tensor_and_made_once(robot):
    assert isinstance(robot.joint_pos, torch.Tensor) and robot.joint_pos.dtype == torch.float64
    assert robot.joint_pos is robot.joint_pos


def test_arrays_are_the_same_numbers_in_numpy(robot):
    arrays = robot.arrays()
    assert isinstance(arrays.joint_pos, np.ndarray)
    np.testing.assert_array_equal(arrays.joint_pos, robot.joint_pos.numpy())


def test_another_thread_sees_a_tensor_while_the_field_is_made(robot, monkeypatch):
    """The page of teleoperation reads the state that the simulation's thread reads."""
    convert, seen = torch.from_numpy, []

    def interrupted(array):
        if not seen:
            seen.append(None)  # what follows reads the field itself
            seen[0] = type(robot.joint_target)
        return convert(array)

    monkeypatch.setattr(torch, "from_numpy", interrupted)
    assert isinstance(robot.joint_target, torch.Tensor)
    assert seen == [torch.Tensor]


def test_what_no_entity_has_is_an_error(robot):
    with pytest.raises(AttributeError, match="colour"):
        _ = robot.colour
