"""What the expert of LIBERO's tasks does, and when chance has a say."""

from dataclasses import astuple

import numpy as np
import pytest

from envs.core.errors import MissingExtraError
from envs.experts.actor import expert_episodes
from envs.spec import EnvSpec

TASK = "libero/object/pick_up_the_milk_and_place_it_in_the_basket"
TRAY = "libero/90/living_room_scene4_stack_the_left_bowl_on_the_right_bowl_and_place_them_in_the_tray"


@pytest.fixture(scope="module")
def milk():
    """A task and its states at two starts."""
    try:
        env = EnvSpec(task=TASK).make(2, observation="state")
    except MissingExtraError as error:
        pytest.skip(str(error))
    env.reset_envs([0, 1], env.split_indices[:2].tolist())
    yield env.task, env.get_states(np.arange(2))
    env.close()


def way(task, state, rng):
    """Returns the waypoints as one array."""
    return np.concatenate([np.ravel(value) for point in task.expert(state, rng) for value in astuple(point)])


def test_a_first_try_follows_from_the_scene_alone(milk):
    task, states = milk
    first, second = (states.select([row]) for row in (0, 1))
    one, same = (way(task, first, np.random.default_rng(seed)) for seed in (0, 1))
    np.testing.assert_array_equal(one, same)
    other = way(task, second, np.random.default_rng(0))
    assert len(other) != len(one) or not np.allclose(other, one)


def test_chance_chooses_the_grasp_once_something_must_have_failed(milk):
    task, states = milk
    rng = np.random.default_rng(0)
    first, second, *later = (way(task, states.select([0]), rng) for _ in range(6))
    np.testing.assert_array_equal(second, first)  # its one atom may hold by now
    assert all(len(each) != len(first) or not np.allclose(each, first) for each in later)


def test_a_bowl_is_let_go_where_the_opening_fingers_do_not_lift_the_tray():
    try:
        env = EnvSpec(task=TRAY).make(1, observation="state")
    except MissingExtraError as error:
        pytest.skip(str(error))
    (episode,) = expert_episodes(env, [int(env.split_indices[1])], record=())
    env.close()
    assert episode.success and episode.length < 250
