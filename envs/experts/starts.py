"""States on the way of a task's expert, for agents that learn by reward to begin at.

An agent that begins where a task begins has to find all of it by chance. One that sometimes begins later,
with the thing in its hand or nearly where it has to be, learns the end first and needs to find only the way
there: Nair et al., "Overcoming Exploration in Reinforcement Learning with Demonstrations"
(arXiv:1709.10089, section IV-D). It is shown states alone, and no action of the expert.
"""

from collections.abc import Sequence

import numpy as np
import torch

from envs.core.errors import ConfigError
from envs.experts.batched_rollout import Progress
from envs.simulators.base import Handler
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
    progress, controller = Progress(rngs, task.planner), task.controller
    # A draw for each step: a moment is as likely as any other, and no episode's length need be known.
    share = np.stack([rng.random(task.max_episode_steps) for rng in rngs]) < moments / task.max_episode_steps
    kept: list[dict[str, torch.Tensor]] = []
    handler.set_states(initial)
    for step in range(task.max_episode_steps):
        states = handler.get_states()
        active = progress.going_on(states.to("cpu"))
        active = active[~progress.success[active]]
        if not len(active):
            break
        if len(chosen := active[share[active, step]]):
            kept.append(states.select(torch.from_numpy(chosen).to(states.device)).flatten())
        controller.advance(handler, progress.actions(), substeps)
        success = task.success(handler.get_states()).cpu().numpy()
        progress.note(active, success, np.zeros(len(rngs)))
    if not kept:
        raise ConfigError(
            f"The expert of {task.name} left no state to begin at: it gave up or was done at once in all of "
            f"{len(rngs)} environments. Take more environments, or expert_starts=0."
        )
    return State.unflatten({key: torch.cat([rows[key] for rows in kept]) for key in kept[0]})
