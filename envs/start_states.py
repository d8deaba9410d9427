"""Banks of states at which the episodes of a reinforcement-learning environment start.

An episode starts at an initial state of the task, or, for a share of the episodes, at a state that the
task's expert passes through. An agent that starts only where the task starts has to find the whole way by
chance. One that sometimes starts later learns the end first: Nair et al., "Overcoming Exploration in
Reinforcement Learning with Demonstrations" (arXiv:1709.10089, section IV-D). Only states are used, no action
of the expert.
"""

from collections.abc import Sequence
from itertools import cycle, islice

import numpy as np
import torch

from envs.core.errors import ConfigError
from envs.randomization import channel_rng, load_split
from envs.simulators.base import Handler
from envs.state import State
from envs.tasks.base import Task
from envs.tasks.plan_following import PlanFollower

BANK_SIZE = 4096
"""Initial states that are kept on the device; sampling one takes Python about 50 µs."""


def initial_bank(task: Task, handler: Handler, split: str, protocol_seed: int, size: int) -> State:
    """Returns initial states of at most ``size`` episodes of a split, on the handler's device."""
    return _initial_states(task, handler, _spread(split, size), protocol_seed)


def expert_bank(task: Task, handler: Handler, split: str, protocol_seed: int, substeps: int) -> State:
    """Returns states on the expert's path, from one episode in each environment of a launched handler.

    Raises:
        ConfigError: as :func:`expert_states`.
    """
    count = handler.num_envs
    episodes = list(islice(cycle(_spread(split, count)), count))
    initial = _initial_states(task, handler, episodes, protocol_seed)
    rngs = [channel_rng(protocol_seed, "expert", episode) for episode in episodes]
    return expert_states(
        task, handler, initial, rngs, substeps=substeps, num_states=max(1, BANK_SIZE // count)
    )


def expert_states(
    task: Task,
    handler: Handler,
    initial: State,
    rngs: Sequence[np.random.Generator],
    *,
    substeps: int,
    num_states: int,
) -> State:
    """Runs the expert in every environment of a handler and keeps states of random steps.

    Args:
        task: The task; its own controller is used.
        handler: A launched handler with N environments; the states they end in are unspecified.
        initial: Initial states, N rows.
        rngs: N generators, for the expert and for which states are kept.
        substeps: Physics steps per control step.
        num_states: States kept on average from an episode of full length.

    Returns:
        States in which the task is not solved, on the handler's device.

    Raises:
        ConfigError: The task has no expert, or no state was kept.
    """
    follower, controller = PlanFollower(rngs, task.planner), task.controller
    # One sample per step: every step is equally likely, and no episode's length has to be known.
    share = num_states / task.max_episode_steps
    keep = np.stack([rng.random(task.max_episode_steps) for rng in rngs]) < share
    kept: list[dict[str, torch.Tensor]] = []
    handler.set_states(initial)
    for step in range(task.max_episode_steps):
        states = handler.get_states()
        active = follower.active(states.to("cpu"))
        active = active[~follower.success[active]]
        if not len(active):
            break
        if len(chosen := active[keep[active, step]]):
            kept.append(states.select(torch.from_numpy(chosen).to(states.device)).flatten())
        controller.advance(handler, follower.next_actions(), substeps)
        success = task.success(handler.get_states()).cpu().numpy()
        follower.record(active, success)
    if not kept:
        raise ConfigError(
            f"The expert of {task.name} left no state to start at: it gave up or succeeded at once in all of "
            f"{len(rngs)} environments. Use more environments, or expert_starts=0."
        )
    return State.unflatten({key: torch.cat([rows[key] for rows in kept]) for key in kept[0]})


def _initial_states(task: Task, handler: Handler, episodes: Sequence[int], protocol_seed: int) -> State:
    rngs = [channel_rng(protocol_seed, "task", episode) for episode in episodes]
    return task.initial_state(rngs).to(handler.device, handler.dtype)


def _spread(split: str, size: int) -> list[int]:
    """Returns at most ``size`` episodes, evenly spaced over a split."""
    episodes = load_split(split).episodes
    if size < len(episodes):
        episodes = episodes[:: len(episodes) // size][:size]
    return [int(episode) for episode in episodes]
