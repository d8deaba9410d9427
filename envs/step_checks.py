"""What an env refuses to step with: actions of another shape, actions that are no numbers, no episode."""

from collections.abc import Sequence

import gymnasium
import numpy as np

from envs.core.errors import RoboVerseError


class InvalidActionError(RoboVerseError, gymnasium.error.InvalidAction):
    """An action that no robot can execute."""


class ResetNeededError(RoboVerseError, gymnasium.error.ResetNeeded):
    """A step of an environment that has no episode yet."""


def check_step(actions: np.ndarray, names: Sequence[str], episodes: np.ndarray) -> None:
    """Checks what a step of N environments is given, in a few microseconds.

    Args:
        actions: What was given, to be (N, A).
        names: What each entry of an action is, A of them.
        episodes: The episode of each environment, (N,); below 0 where none has begun.

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
        raise ResetNeededError("step() was called before an episode began. Call reset() first.")


def wrong_shape(actions: np.ndarray, shape: tuple[int, ...], names: Sequence[str]) -> InvalidActionError:
    """Builds the error for actions of another shape, or of something else than numbers."""
    known = ", ".join(names)
    what = "Actions are a row for each environment" if len(shape) > 1 else "An action is one row"
    return InvalidActionError(
        f"{what}, numbers of the shape {shape}: {known}. Given was an array of {actions.dtype} of the shape "
        f"{actions.shape}."
    )
