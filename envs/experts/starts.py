"""States on the way of a task's expert, for agents that learn by reward to begin at.

An agent that begins where a task begins has to find all of it by chance. One that sometimes begins later,
with the thing in its hand or nearly where it has to be, learns the end first and needs to find only the way
there: Nair et al., "Overcoming Exploration in Reinforcement Learning with Demonstrations"
(arXiv:1709.10089, section IV-D). It is shown states alone, and no action of the expert.
"""

from collections.abc import Sequence

import numpy as np
import torch

from envs.errors import ConfigError
from envs.experts.batched_rollout import plan_all
from envs.experts.planner import Planner
from envs.handlers.base import Handler
from envs.state import State
from envs.tasks.base import Task


def states_on_the_way(
    task: Task,
    handler: Handler,
    initial: State,
    rngs: Sequence[np.random.Generator],
    *,
    substeps: int,
    moments: int,
) -> State:
    """Follows the expert in every environment of a handler, and keeps states at random moments.

    Args:
        task: The task; its own controller is used.
        handler: A launched handler with N environments, which are left somewhere.
        initial: Where the experts begin, N rows.
        rngs: N generators: of what the expert does, and of when its state is kept.
        substeps: Physics steps per control step.
        moments: How many states are kept, on average, of an expert that takes a whole episode.

    Returns:
        States in which the task is not solved, on the handler's device.

    Raises:
        ConfigError: if the task has no expert, or nothing was kept.
    """
    planner, controller = task.planner, task.controller
    handler.set_states(initial)
    states = handler.get_states()
    plans: list[list[np.ndarray]] = [[] for _ in rngs]
    kept: list[dict[str, torch.Tensor]] = []
    # A draw for each step: a moment is as likely as any other, and no episode's length need be known.
    share = np.stack([rng.random(task.max_episode_steps) for rng in rngs]) < moments / task.max_episode_steps
    goes_on = np.ones(len(rngs), bool)
    actions = controller.hold(states.to("cpu"))
    for step in range(task.max_episode_steps):
        _extend(plans, goes_on, planner, states, rngs)
        goes_on &= [bool(plan) for plan in plans]
        goes_on &= ~task.success(states).cpu().numpy()
        if not goes_on.any():
            break
        chosen = np.flatnonzero(goes_on & share[:, step])
        if len(chosen):
            kept.append(states.select(torch.from_numpy(chosen).to(states.device)).flatten())
        for row in np.flatnonzero(goes_on):
            actions[row] = plans[row].pop(0)
        controller.advance(handler, actions, substeps)
        states = handler.get_states()
    if not kept:
        raise ConfigError(
            f"The expert of {task.name} left no state to begin at: it gave up or was done at once in all of "
            f"{len(rngs)} environments. Take more environments, or expert_starts=0."
        )
    return State.unflatten({key: torch.cat([rows[key] for rows in kept]) for key in kept[0]})


def _extend(
    plans: list[list[np.ndarray]],
    goes_on: np.ndarray,
    planner: Planner,
    states: State,
    rngs: Sequence[np.random.Generator],
) -> None:
    """Asks the planner wherever a plan is used up."""
    asked = [row for row, plan in enumerate(plans) if goes_on[row] and not plan]
    if asked:
        rows = states.select(asked).to("cpu")
        for row, plan in zip(asked, plan_all(planner, rows, [rngs[row] for row in asked]), strict=True):
            plans[row] = list(plan)
