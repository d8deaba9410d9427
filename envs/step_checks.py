"""Checks before a step: the shape of the actions, finite numbers, a started episode; and before a reset."""

import operator
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np

from envs.core.errors import ConfigError, RoboVerseError, unknown_name

_FOR_WRAPPERS = "lerobot_"
"""Begin of the options that LeRobot's evaluation gives its own wrappers."""


class InvalidActionError(RoboVerseError, gymnasium.error.InvalidAction):
    """An action that no robot can execute."""


class ResetNeededError(RoboVerseError, gymnasium.error.ResetNeeded):
    """A step of an environment without an episode."""


def check_step(actions: np.ndarray, names: Sequence[str], episodes: np.ndarray) -> None:
    """Checks the actions of a step of N environments, in a few microseconds.

    Args:
        actions: The actions; (N, A) is valid.
        names: Names of the A entries of an action.
        episodes: The episode of each environment, (N,); negative where none has started.

    Raises:
        InvalidActionError: The actions have another shape, or an entry is not finite.
        ResetNeededError: An environment has no episode.
    """
    if actions.shape != (len(episodes), len(names)) or actions.dtype.kind not in "fiu":
        raise wrong_shape(actions, (len(episodes), len(names)), names)
    if not np.isfinite(actions).all():
        env, entry = np.argwhere(~np.isfinite(actions))[0]
        where = f" of environment {env}" if len(episodes) > 1 else ""
        raise InvalidActionError(
            f"The action{where} is not finite: {names[entry]} is {actions[env, entry]}. Check what computes "
            "it, such as a policy whose training diverged."
        )
    if episodes.min() < 0:
        raise ResetNeededError("step() was called before an episode started. Call reset() first.")


def wrong_shape(actions: np.ndarray, shape: tuple[int, ...], names: Sequence[str]) -> InvalidActionError:
    """Returns the error for actions of another shape, or that are not numbers."""
    what = "Actions have one row per environment" if len(shape) > 1 else "An action is one row"
    return InvalidActionError(
        f"{what}, numbers of shape {shape}: {', '.join(names)}. Given: an array of {actions.dtype} of shape "
        f"{actions.shape}."
    )


def check_reset_options(options: Iterable[str], valid: Sequence[str]) -> None:
    """Checks the names of the options of a reset; those of LeRobot's wrappers are let through.

    Raises:
        UnknownNameError: There is no such option.
    """
    for name in options:
        if name not in valid and not name.startswith(_FOR_WRAPPERS):
            raise unknown_name("option of reset()", name, valid)


def read_reset_options(options: Mapping[str, Any] | None, num_envs: int) -> tuple[np.ndarray, Any]:
    """Checks the options of a reset of N environments.

    Args:
        options: ``episodes`` and ``reset_mask`` of :meth:`envs.vector_env.RoboVerseVectorEnv.reset`.
        num_envs: N.

    Returns:
        The environments to reset, and the episode of each; None where no episode is given.

    Raises:
        ConfigError: The mask is not one of N environments, or there is not one episode for each to reset.
        UnknownNameError: There is no such option.
    """
    if not options:
        return np.arange(num_envs), None
    check_reset_options(options, ("episodes", "reset_mask"))
    mask = np.asarray(options.get("reset_mask", np.ones(num_envs, bool)))
    if mask.shape != (num_envs,) or mask.dtype != bool:
        raise ConfigError(
            f"options['reset_mask'] has one bool for each of the {_counted(num_envs, 'environment')}, shape "
            f"({num_envs},): whether it is reset. Given: shape {mask.shape} of {mask.dtype}. "
            f"np.isin(np.arange({num_envs}), [0]) resets the first alone."
        )
    ids = np.flatnonzero(mask)
    if (given := options.get("episodes")) is None:
        return ids, None
    wanted = f"{_counted(len(ids), 'environment')} {'is' if len(ids) == 1 else 'are'} reset"
    advice = f"Give one for each, as in options={{'episodes': env.split_indices[:{len(ids)}]}}."
    try:
        episodes = [operator.index(episode) for episode in given]
    except TypeError as error:
        raise ConfigError(
            f"{wanted}, and options['episodes'] is a list of their episodes, which are whole numbers. "
            f"Given: {given!r}. {advice}"
        ) from error
    if len(episodes) != len(ids):
        raise ConfigError(
            f"{wanted}, and options['episodes'] holds {_counted(len(episodes), 'episode')}: {episodes}. "
            f"{advice}"
        )
    return ids, episodes


def _counted(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"
