import numpy as np
import pytest

from benchmark.inputs import ALL_IMAGES, Call, input_shares
from benchmark.runner import PolicyActor
from envs.core.errors import ConfigError
from envs.rollout import rollout
from tests.benchmark.conftest import JOINTS, NoisyPolicy, PointEnv

WORDS = ("wave", "jump")


class SeeingEnv(PointEnv):
    """PointEnv whose images show the episode, by two cameras, and whose instruction is observed."""

    def observe(self, env_ids):
        observation = super().observe(env_ids)
        images = np.stack([np.full((4, 4, 3), self._episode[env_id], np.uint8) for env_id in env_ids])
        shown = {f"observation.images.{name}": images for name in ("front", "wrist")}
        return observation | shown | {"task": ["reach"] * len(env_ids)}


class Follower:
    """Its action is a sum of what it sees: each input times a weight."""

    n_obs_steps, n_action_steps, batch_invariant = 1, 4, True

    def __init__(self, **weights):
        self.weights, self.asked = weights, []

    def act(self, observation, generators=()):
        self.asked.append(list(observation["task"]))
        images = {name: observation[f"observation.images.{name}"][:, 0, 0, 0] for name in ("front", "wrist")}
        words = np.array([len(text) for text in observation["task"]])
        seen = images | {"state": observation["observation.state"][:, -1], "words": words}
        total = sum(weight * np.asarray(seen[name], float) for name, weight in self.weights.items())
        return np.broadcast_to(np.asarray(total)[:, None, None], (len(words), self.n_action_steps, JOINTS))


def shares(policy, env=None, **settings):
    settings = {"calls": 1, "instructions": WORDS} | settings
    return input_shares(policy, env or SeeingEnv(6), **settings)


@pytest.mark.parametrize(
    ("input_name", "weights"),
    [("state", {"state": 1.0}), ("images.front", {"front": 0.1}), ("images.wrist", {"wrist": 0.1})],
)
def test_the_one_input_that_decides_has_the_whole_share(input_name, weights):
    (call,) = shares(Follower(**weights))
    expected = dict.fromkeys(("state", "images.front", "images.wrist", "instruction", ALL_IMAGES), 0.0)
    expected[input_name] = 1.0
    if "images" in input_name:
        expected[ALL_IMAGES] = 1.0
    assert {name: call.share(name) for name in call.moved} == pytest.approx(expected)


def test_actions_move_by_the_distance_to_the_next_three_episodes():
    """Images show 100 to 103: one episode on they differ by 3, 1, 1, 1, two on by 2, then by 1, 1, 1, 3."""
    (call,) = shares(Follower(front=1.0), SeeingEnv(4))
    assert call.moved_by_all == pytest.approx((6 + 8 + 6) / 12)
    assert call.moved["images.front"] == pytest.approx(call.moved_by_all)


def test_an_instruction_of_another_task_moves_what_reads():
    policy = Follower(words=1.0, front=1.0)
    (call,) = shares(policy, SeeingEnv(4))
    assert call.moved["instruction"] == pytest.approx(len("reach") - len("wave"))
    assert ["reach"] * 4 in policy.asked
    assert any(set(words) <= set(WORDS) for words in policy.asked)
    assert "instruction" not in shares(Follower(front=1.0), instructions=())[0].moved


def test_noise_of_an_episode_is_the_same_in_every_question(noisy_policy):
    (call,) = input_shares(noisy_policy(noise=5.0), PointEnv(6), calls=1)
    assert call.moved["images.front"] == 0.0, "PointEnv's images are alike"
    assert call.share("state") == 1.0


def test_episodes_go_on_as_without_questions(point_env):
    class Recording(NoisyPolicy):
        def act(self, observation, generators=()):
            seen.append(observation["observation.state"])
            return super().act(observation, generators)

    seen: list[np.ndarray] = []
    env = point_env(6)
    list(rollout(env, PolicyActor(Recording(), env, 0), range(100, 106)))
    first, second, *_ = seen
    seen.clear()
    input_shares(Recording(), point_env(6), calls=2)
    questions = 3 * len(("state", "images.front", "all"))
    assert np.array_equal(seen[0], first)
    assert np.array_equal(seen[1 + questions], second)


def test_measuring_ends_with_the_last_call_that_is_wanted_or_the_first_episode_that_is_over():
    env = SeeingEnv(6, horizon=24)
    calls = shares(Follower(front=0.1), env, calls=2)
    assert [call.step for call in calls] == [0, 4]
    assert max(env.observed.values()) <= 3
    assert len(shares(Follower(front=0.1), SeeingEnv(6, horizon=12), calls=50)) == 3


def test_a_policy_that_nothing_moves_has_no_shares():
    (call,) = shares(Follower(front=0.0))
    assert call.moved_by_all == 0.0
    assert np.isnan(call.share("state"))


def test_a_share_is_of_what_all_inputs_move():
    assert Call(step=0, moved={"state": 0.5}, moved_by_all=2.0).share("state") == 0.25


def test_too_few_episodes_are_an_error():
    with pytest.raises(ConfigError, match=r"episodes=3 are too few .* 4 or more"):
        shares(Follower(front=1.0), SeeingEnv(3))


def test_more_episodes_than_the_split_has_are_an_error():
    with pytest.raises(ConfigError, match=r"The split has 5 episodes, given episodes=6\. Give 5 or fewer"):
        shares(Follower(front=1.0), SeeingEnv(6, split_size=5))
