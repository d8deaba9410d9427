"""What an env refuses to step or to reset with, and that it says so in one clear error."""

import contextlib
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest
import torch
from lerobot.envs.utils import NEW_ROLLOUT_OPTION

import envs
from envs.core.errors import ConfigError, RoboVerseError, UnknownNameError
from envs.step_checks import InvalidActionError, ResetNeededError
from envs.vector_env import RoboVerseVectorEnv

REST = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0, 0.04, 0.04], np.float32)


@pytest.fixture(scope="module")
def single() -> Iterator[envs.RoboVerseEnv]:
    env = envs.RoboVerseEnv("PickCube", observation="state")
    with contextlib.closing(env):
        yield env


@pytest.fixture(scope="module")
def batch() -> Iterator[RoboVerseVectorEnv]:
    env = envs.make_vec("PickCube", 3, observation="state")
    with contextlib.closing(env):
        yield env


def not_finite(value: float, row: int = 1) -> np.ndarray:
    actions = np.repeat(REST[None], 3, 0)
    actions[row, 4] = value
    return actions


@pytest.mark.parametrize("shape", [(7,), (1, 9), (), (10,)])
def test_one_action_of_another_shape_is_refused(single: envs.RoboVerseEnv, shape: tuple[int, ...]) -> None:
    single.reset(seed=0)
    with pytest.raises(InvalidActionError, match=r"An action is one row, .* shape \(9,\): joint1, ") as error:
        single.step(np.zeros(shape, np.float32))
    assert str(error.value).endswith(f"Given: an array of float32 of shape {shape}.")


@pytest.mark.parametrize("shape", [(9,), (2, 9), (3, 7), (3, 9, 1)])
def test_actions_of_another_shape_are_refused(batch: RoboVerseVectorEnv, shape: tuple[int, ...]) -> None:
    batch.reset(seed=0)
    with pytest.raises(InvalidActionError, match=r"Actions have one row per environment.* shape \(3, 9\)"):
        batch.step(np.zeros(shape))


def test_actions_that_are_words_are_refused(batch: RoboVerseVectorEnv) -> None:
    batch.reset(seed=0)
    with pytest.raises(InvalidActionError, match="Given: an array of <U1 of shape"):
        batch.step(np.full((3, 9), "a"))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_action_that_is_not_finite_is_refused_by_its_place(
    batch: RoboVerseVectorEnv, single: envs.RoboVerseEnv, value: float
) -> None:
    batch.reset(seed=0)
    with pytest.raises(InvalidActionError, match=rf"environment 1 is not finite: joint5 is {value}\."):
        batch.step(not_finite(value))
    single.reset(seed=0)
    with pytest.raises(InvalidActionError, match=rf"The action is not finite: joint5 is {value}\."):
        single.step(not_finite(value)[1])


def test_a_refused_action_changes_nothing(batch: RoboVerseVectorEnv) -> None:
    batch.reset(seed=0)
    before = batch.get_states().flatten()
    with pytest.raises(InvalidActionError):
        batch.step(not_finite(np.nan))
    after = batch.get_states().flatten()
    assert all(np.array_equal(before[key], after[key]) for key in before)
    assert batch.elapsed_steps.tolist() == [0, 0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("observation", ["pixels", "state"])
def test_a_step_before_the_first_reset_is_refused(observation: str) -> None:
    for env, action in (
        (envs.RoboVerseEnv("PickCube", observation=observation, image_size=32), REST),
        (envs.make_vec("PickCube", 2, observation=observation, image_size=32), np.repeat(REST[None], 2, 0)),
    ):
        with contextlib.closing(env), pytest.raises(ResetNeededError, match=r"Call reset\(\) first"):
            env.step(action)


def test_env_left_out_of_the_reset_is_an_error() -> None:
    with contextlib.closing(envs.make_vec("PickCube", 2, observation="state")) as env:
        env.reset(options={"reset_mask": np.array([True, False])})
        with pytest.raises(ResetNeededError):
            env.step(np.repeat(REST[None], 2, 0))


AS_IN = r"Give one for each, as in options=\{'episodes': env\.split_indices\[:3\]\}\."


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            {"episodes": [0]},
            rf"3 environments are reset, and options\['episodes'\] holds 1 episode: .*{AS_IN}",
        ),
        ({"episodes": [0, 1, 2, 3]}, r"3 environments are reset, and .* holds 4 episodes: \[0, 1, 2, 3\]\."),
        ({"episodes": []}, r"3 environments are reset, and .* holds 0 episodes: \[\]\."),
        ({"episodes": 3}, rf"which are whole numbers\. Given: 3\. {AS_IN}"),
        ({"episodes": "012"}, r"which are whole numbers\. Given: '012'\."),
        ({"episodes": [0, 1.5, 2]}, r"which are whole numbers\. Given: \[0, 1\.5, 2\]\."),
        ({"episodes": [[0, 1, 2]]}, r"which are whole numbers\. Given: \[\[0, 1, 2\]\]\."),
        (
            {"episodes": [0, 1, 2], "reset_mask": np.array([False, True, False])},
            r"1 environment is reset, and .* holds 3 episodes",
        ),
        (
            {"reset_mask": [True]},
            r"one bool for each of the 3 environments, .* Given: shape \(1,\) of bool",
        ),
        (
            {"reset_mask": [0, 2, 1]},
            r"of the 3 environments, .* Given: shape \(3,\) of int64\. np\.isin\(np\.arange\(3\), \[0\]\)",
        ),
        ({"reset_mask": np.ones(3, np.uint8)}, r"whether it is reset\. Given: shape \(3,\) of uint8\."),
    ],
)
def test_a_reset_that_does_not_fit_the_environments_is_refused_and_changes_nothing(
    batch: RoboVerseVectorEnv, options: dict, message: str
) -> None:
    batch.reset(seed=0)
    episodes, before, draws = batch.episodes.copy(), batch.get_states().flatten(), batch._rngs[0]
    with pytest.raises(ConfigError, match=message):
        batch.reset(seed=1, options=options)
    after = batch.get_states().flatten()
    assert batch.episodes.tolist() == episodes.tolist() and batch._rngs[0] is draws
    assert all(np.array_equal(before[key], after[key]) for key in before)


def test_an_unknown_option_of_a_reset_is_refused_with_the_nearest(batch: RoboVerseVectorEnv) -> None:
    with pytest.raises(UnknownNameError) as error:
        batch.reset(options={"episode": [1, 2, 3]})
    assert str(error.value) == (
        "Unknown option of reset() 'episode'. Did you mean 'episodes'? Valid: episodes, reset_mask."
    )


def test_an_unknown_option_of_one_environment_is_refused_and_changes_nothing(
    single: envs.RoboVerseEnv,
) -> None:
    single.reset(seed=0)
    episode, draws = single.batch.episodes[0], single.np_random.bit_generator.state
    with pytest.raises(UnknownNameError) as error:
        single.reset(seed=1, options={"episodes": [3]})
    assert str(error.value) == "Unknown option of reset() 'episodes'. Did you mean 'episode'? Valid: episode."
    assert single.batch.episodes[0] == episode and single.np_random.bit_generator.state == draws
    single.reset(seed=0, options={NEW_ROLLOUT_OPTION: True, "episode": None})
    assert single.batch.episodes[0] == episode


def test_a_reset_takes_episodes_as_list_array_and_tensor_and_the_options_of_wrappers(
    batch: RoboVerseVectorEnv,
) -> None:
    wanted = batch.split_indices[[4, 2, 7]]
    for given in (wanted, wanted.tolist(), tuple(wanted), torch.from_numpy(wanted)):
        batch.reset(options={"episodes": given})
        assert batch.episodes.tolist() == wanted.tolist()
    batch.reset(options={"episodes": wanted[:1], "reset_mask": torch.tensor([False, True, False])})
    assert batch.episodes.tolist() == wanted[[0, 0, 2]].tolist()
    batch.reset(options={"episodes": wanted[1:2], "reset_mask": [True, False, False]})
    assert batch.episodes.tolist() == wanted[[1, 0, 2]].tolist()
    batch.reset(seed=0, options={NEW_ROLLOUT_OPTION: True, "episodes": None})
    seeded = batch.episodes.copy()
    batch.reset(seed=0)
    assert batch.episodes.tolist() == seeded.tolist()


def test_the_errors_are_those_that_gymnasium_and_our_command_line_know() -> None:
    assert issubclass(InvalidActionError, gymnasium.error.InvalidAction)
    assert issubclass(ResetNeededError, gymnasium.error.ResetNeeded)
    assert issubclass(InvalidActionError, RoboVerseError) and issubclass(ResetNeededError, RoboVerseError)
