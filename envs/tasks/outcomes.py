"""Reward, termination and success of a control step, by the rules of a task."""

from typing import NamedTuple

from envs.array_ops import Array, filled
from envs.state import State
from envs.tasks.base import Task


class Outcome(NamedTuple):
    """The outcome of a control step of N environments, each (N,).

    Attributes:
        reward: Reward of the step.
        terminated: Whether success or failure ends the episode.
        success: Whether the state is a success; :func:`solved` adds the tasks that judge the return.
    """

    reward: Array
    terminated: Array
    success: Array


def outcome(task: Task, state: State) -> Outcome:
    """Returns the outcome of a step that led to ``state``, as NumPy arrays if the state has them."""
    success, reward = task.success(state), task.reward(state)
    if task.ends_on_success:
        reward = filled(reward, success, 1.0)
    if type(task).failure is Task.failure:  # no failures: 10 % faster for one state
        return Outcome(reward, success if task.ends_on_success else success & False, success)
    failed = task.failure(state) & ~success
    return Outcome(reward, success | failed if task.ends_on_success else failed, success)


def solved(task: Task, success: Array, over: Array, returns: Array) -> Array:
    """Returns whether episodes are solved, (N,) bool.

    Args:
        task: The task.
        success: Success of their present states, (N,) bool.
        over: Which episodes are over, (N,) bool: the return of any other is not final.
        returns: Sum of their rewards so far, (N,).
    """
    bar = task.success_return
    return success if bar is None else over & (returns >= bar)
