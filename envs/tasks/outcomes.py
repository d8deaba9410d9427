"""What a control step led to, by a task's own rules: reward, success, and whether the episode is over."""

from typing import NamedTuple

from envs.array_ops import Array, filled
from envs.state import State
from envs.tasks.base import Task


class Outcome(NamedTuple):
    """What N environments came to, each (N,).

    Attributes:
        reward: Reward of the step.
        terminated: Whether success or failure ends the episode.
        success: Whether the state is a success; see :func:`solved` for tasks that judge the return.
    """

    reward: Array
    terminated: Array
    success: Array


def outcome(task: Task, state: State) -> Outcome:
    """Judges the states after a step, in arrays where the state is of arrays."""
    success, reward = task.success(state), task.reward(state)
    if task.ends_on_success:
        reward = filled(reward, success, 1.0)
    if type(task).failure is Task.failure:  # nothing is ever lost: saves a tenth of judging one state
        return Outcome(reward, success if task.ends_on_success else success & False, success)
    failed = task.failure(state) & ~success
    return Outcome(reward, success | failed if task.ends_on_success else failed, success)


def solved(task: Task, success: Array, over: Array, returns: Array) -> Array:
    """Returns whether episodes are solved, (N,) bool.

    Args:
        task: The task.
        success: Success of their present states, (N,) bool.
        over: Which of them are over, (N,) bool: no other one is solved by its return.
        returns: Sum of their rewards so far, (N,).
    """
    bar = task.success_return
    return success if bar is None else over & (returns >= bar)
