import math

import numpy as np
import pytest

from benchmark.protocol import Protocol
from benchmark.runner import PolicyActor, episode_generator, evaluate, evaluate_cell
from benchmark.statistics import narrow_after
from envs.core.errors import CheckpointError, ConfigError, SimulatorError
from envs.rollout import rollout

CELL = {"split": "test", "level": 2, "seed": 0, "policy_name": "noisy"}


def outcomes(records):
    return [record.to_json() | {"wall_time_s": None} for record in records]


@pytest.mark.slow
@pytest.mark.parametrize(("n_obs_steps", "n_action_steps"), [(1, 5), (3, 4), (3, 1), (6, 2)])
def test_records_do_not_depend_on_the_number_of_envs(point_env, noisy_policy, n_obs_steps, n_action_steps):
    episodes = list(range(100, 130))
    runs = [
        evaluate_cell(noisy_policy(n_action_steps, n_obs_steps), point_env(num_envs), episodes, **CELL)
        for num_envs in (1, 4, 16)
    ]
    assert outcomes(runs[0]) == outcomes(runs[1]) == outcomes(runs[2])
    assert [record.episode for record in runs[0]] == episodes
    assert 0 < sum(record.success for record in runs[0]) < len(episodes), "the test would show nothing"


def test_a_cell_ends_once_its_interval_is_narrow_for_any_number_of_envs(point_env, noisy_policy):
    episodes = list(range(100, 150))
    whole = evaluate_cell(noisy_policy(), point_env(4), episodes, **CELL)
    for width in (0.8, 0.5):
        enough = narrow_after([record.success for record in whole], width)
        assert enough is not None and 1 < enough < len(episodes)
        for num_envs in (1, 4, 16):
            ended = evaluate_cell(noisy_policy(), point_env(num_envs), episodes, width=width, **CELL)
            assert outcomes(ended) == outcomes(whole[:enough])


@pytest.mark.parametrize("num_envs", [1, 3])
def test_episode_renders_once_per_chunk(point_env, noisy_policy, num_envs):
    env = point_env(num_envs)
    records = evaluate_cell(noisy_policy(n_action_steps=5), env, list(range(100, 112)), **CELL)
    assert {r.episode: math.ceil(r.length / 5) for r in records} == dict(env.observed)
    assert len({r.length for r in records}) > 1


def test_history_renders_only_the_steps_it_holds(point_env, noisy_policy):
    """Chunks of 6 and a history of 2: steps 0, 5, 6, 11, 12, 17, 18, 23 of 24."""
    env = point_env()
    records = evaluate_cell(noisy_policy(6, n_obs_steps=2, noise=9.0), env, [100], **CELL)
    assert records[0].length == 24
    assert env.observed[100] == 8


def test_history_is_the_newest_steps_and_starts_with_the_first(point_env, noisy_policy):
    class Spy(noisy_policy):
        def act(self, observation, generators=None):
            seen.append(observation["observation.images.front"][0, :, 0, 0, 0] // 10)
            return super().act(observation, generators)

    seen = []
    evaluate_cell(Spy(4, n_obs_steps=3, noise=9.0), point_env(horizon=10), [100], **CELL)
    assert [list(steps) for steps in seen] == [[0, 0, 0], [2, 3, 4], [6, 7, 8]]


def test_envs_are_observed_together(point_env, noisy_policy):
    env, policy = point_env(4), noisy_policy()
    evaluate_cell(policy, env, list(range(100, 120)), **CELL)
    assert np.mean([len(batch) for batch in env.observe_batches]) > 3
    assert [len(batch) for batch in env.observe_batches] == [shape[0] for shape in policy.batches]


def test_more_envs_than_episodes(point_env, noisy_policy):
    records = evaluate_cell(noisy_policy(), point_env(8), [103, 101], **CELL)
    assert [record.episode for record in records] == [103, 101]


def test_records_name_simulator_channels_and_versions(point_env, noisy_policy):
    (record,) = evaluate_cell(noisy_policy(), point_env(), [100], **CELL)
    assert (record.task, record.policy, record.simulator, record.renderer) == (
        "Reach",
        "noisy",
        "point",
        "flat",
    )
    assert (record.channels, record.not_shown) == (("task",), ("metallic",))
    assert record.initial_state_hash == "0000000000000064"
    assert record.versions["numpy"] == np.__version__
    assert record.wall_time_s > 0


def test_on_episode_sees_every_record(point_env, noisy_policy):
    seen = []
    records = evaluate_cell(
        noisy_policy(), point_env(4), list(range(100, 110)), on_episode=seen.append, **CELL
    )
    assert sorted(seen, key=lambda record: record.episode) == records


def test_noise_follows_seed_and_episode():
    first, same, other = episode_generator(0, 5), episode_generator(0, 5), episode_generator(0, 6)
    assert first.initial_seed() == same.initial_seed() != other.initial_seed()
    assert episode_generator(1, 5).initial_seed() != first.initial_seed()


def test_nan_action_names_episode_and_step(point_env, noisy_policy):
    class Diverged(noisy_policy):
        def act(self, observation, generators=None):
            chunk = super().act(observation, generators)
            return np.where(len(self.batches) > 2, np.nan, chunk)

    with pytest.raises(CheckpointError, match=r"episode 100 at step 10 \(Reach, level 2, test split\)"):
        evaluate_cell(Diverged(noise=9.0), point_env(), [100], **CELL)


def test_wrong_action_shape_names_the_expected_one(point_env, noisy_policy):
    class Short(noisy_policy):
        def act(self, observation, generators=None):
            return super().act(observation, generators)[:, :, :7]

    with pytest.raises(CheckpointError, match=r"\(1, 5, 7\); Reach takes \(1, 5, 9\)"):
        evaluate_cell(Short(), point_env(), [100], **CELL)


def test_repeated_episode_is_refused(point_env, noisy_policy):
    with pytest.raises(ConfigError, match="listed twice"):
        evaluate_cell(noisy_policy(), point_env(), [100, 100], **CELL)


def test_env_that_never_truncates_is_an_error(point_env, noisy_policy):
    with pytest.raises(SimulatorError, match=r"Episode 100 of Reach did not end after 24 steps"):
        evaluate_cell(noisy_policy(noise=9.0), point_env(truncates=False), [100], **CELL)


def test_evaluate_runs_every_cell_and_closes_its_envs(point_env, noisy_policy):
    envs, cells = [], []

    def make_env(cell):
        envs.append(point_env(2))
        return envs[-1]

    protocol = Protocol(levels=(0, 1), only=("camera",), splits=("test",), episodes=3)
    records = evaluate(
        noisy_policy(),
        make_env,
        protocol,
        policy_name="noisy",
        on_cell=lambda cell, env, found: cells.append(cell),
    )
    assert cells == list(protocol.cells())
    assert [(r.level, r.only, r.episode) for r in records[::3]] == [
        (0, None, 100),
        (1, None, 100),
        (None, "camera", 100),
    ]
    assert len(records) == 9
    assert all(env.closed for env in envs)


def test_evaluate_closes_the_env_of_a_failed_cell(point_env, noisy_policy):
    env = point_env()
    with pytest.raises(ConfigError, match="100 episodes were requested and the split has 50"):
        evaluate(noisy_policy(), lambda _: env, Protocol(), policy_name="noisy")
    assert env.closed


def test_rollout_calls_on_step_and_gathers_the_episode(point_env, noisy_policy):
    steps, env = [], point_env()
    actor = PolicyActor(noisy_policy(noise=9.0), env, seed=0)
    (episode,) = rollout(env, actor, [100], on_step=lambda running: steps.append(running.length))
    assert steps == list(range(25))
    assert (episode.length, episode.instruction) == (24, "Reach goal 100.")
    assert episode.actions.shape == (24, 9)
    assert not episode.success and not episode.successes.any()
    assert episode.episode_return == pytest.approx(episode.rewards.sum())
