"""Checks before a step: the shape of the actions, finite numbers, and a started episode."""

from collections.abc import Sequence

import gymnasium
import numpy as np

from envs.core.errors import RoboVerseError


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
