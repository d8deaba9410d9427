import numpy as np
import pytest

from envs.core.errors import CheckpointError
from roboverse_learn.teleoperation.policy_driver import PolicyDriver
from roboverse_learn.teleoperation.station import Station


class Policy:
    """Repeats the joints that it observes, in chunks, and keeps what it was shown."""

    def __init__(self, n_obs_steps=1, n_action_steps=3):
        self.n_obs_steps, self.n_action_steps = n_obs_steps, n_action_steps
        self.shown, self.generators = [], []

    def act(self, observation, generators):
        self.shown.append(observation["observation.state"])
        self.generators.append(generators)
        newest = self.shown[-1].reshape(-1, 9)[-1]
        return np.tile(newest, (1, self.n_action_steps, 1))


@pytest.fixture
def station(pick_cube):
    station = Station(pick_cube, 0)
    station.start(int(pick_cube.split_indices[0]))
    return station


def test_a_policy_observes_once_for_each_chunk(pick_cube, station):
    policy = Policy()
    driver = PolicyDriver(policy, pick_cube, {"policy": "repeat"})
    driver.begin(0)
    for _ in range(7):
        action = driver.act(station)
        assert action.shape == (9,) and action.dtype == np.float32
        station.step(action)
    assert len(policy.shown) == 3 and policy.shown[0].shape == (1, 9)
    assert driver.facts == {"policy": "repeat"}


def test_a_policy_with_a_history_sees_the_steps_before_its_chunk(pick_cube, station):
    policy = Policy(n_obs_steps=2)
    driver = PolicyDriver(policy, pick_cube)
    driver.begin(0)
    seen = []
    for _ in range(4):
        seen.append(station.observe()["observation.state"])
        station.step(driver.act(station) + np.float32(0.01))
    np.testing.assert_array_equal(policy.shown[0][0], [seen[0], seen[0]])  # the first is repeated
    np.testing.assert_array_equal(policy.shown[1][0], [seen[2], seen[3]])


def test_what_is_handed_back_begins_a_new_chunk_with_the_episodes_noise(pick_cube, station):
    policy = Policy()
    driver = PolicyDriver(policy, pick_cube)
    for _ in range(2):
        driver.begin(5)
        driver.act(station)
    first, second = (generators[0].get_state() for generators in policy.generators)
    assert len(policy.shown) == 2 and bool((first == second).all())


def test_actions_that_do_not_fit_are_reported(pick_cube, station):
    policy = Policy()
    policy.act = lambda observation, generators: np.zeros((1, 3, 4))
    driver = PolicyDriver(policy, pick_cube)
    driver.begin(0)
    with pytest.raises(CheckpointError, match="returned actions of shape"):
        driver.act(station)
