"""What a control step led to, by a task's own rules: reward, success, and whether the episode is over."""

from typing import NamedTuple

from torch import Tensor

from envs.state import State
from envs.tasks.base import Task


class Outcome(NamedTuple):
    """What N environments came to, each (N,).

    Attributes:
        reward: Reward of the step.
        terminated: Whether success or failure ends the episode.
        success: Whether the state is a success; see :func:`solved` for tasks that judge the return.
    """

    reward: Tensor
    terminated: Tensor
    success: Tensor


def outcome(task: Task, state: State) -> Outcome:
    """Judges the states after a step."""
    success, reward = task.success(state), task.reward(state)
    if task.ends_on_success:
        reward = reward.masked_fill(success, 1.0)  # a third of the time of torch.where
        if type(task).failure is Task.failure:  # nothing is ever lost: saves a tenth of judging one state
            return Outcome(reward, success, success)
    failed = task.failure(state) & ~success
    return Outcome(reward, success | failed if task.ends_on_success else failed, success)


def solved(task: Task, success: Tensor, over: Tensor, returns: Tensor) -> Tensor:
    """Returns whether episodes are solved, (N,) bool.

    Args:
        task: The task.
        success: Success of their present states, (N,) bool.
        over: Which of them are over, (N,) bool: no other one is solved by its return.
        returns: Sum of their rewards so far, (N,).
    """
    bar = task.success_return
    return success if bar is None else over & (returns >= bar)
