"""TD-MPC2, FastTD3 and the replay buffer, against plain torch and TorchRL: ``roboverse speed agents``.

Both sides of an update learn from the same batches of a humanoid's size (51 observations, 19 actions). On a
GPU our side is compiled and recorded as a CUDA graph, FastTD3 in bf16; plain torch computes in tf32. On a
CPU neither is compiled, and the sizes are small. The replay buffer is compared on any device to TorchRL's
``SliceSampler`` over the same episodes.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch

from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from roboverse_learn.speed.harness import (
    Call,
    Goal,
    Measurement,
    Settings,
    cuda_wait,
    in_turns,
    measurement,
    program,
    repeat,
)

OBSERVATION, OBSERVED, ACTIONS, EPISODE = "observation.environment_state", 51, 19, 1000
STEPS, ENVS, SEQUENCES, HORIZON = 100_000, 100, 256, 4
"""Size of the replay buffer, and of the batches sampled from it."""
GOAL = 2.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """Sizes and repetitions of a measurement."""

    model_size: Any  # size of TD-MPC2
    sequences: int  # its sequences per update
    plan_envs: int  # environments that are planned for at once
    fasttd3_steps: int  # steps per update of FastTD3
    fasttd3_dim: int  # width of its critics
    updates: int  # timed calls of one turn
    turns: int  # how often each side is timed


GPU = Scale(
    model_size=5, sequences=256, plan_envs=64, fasttd3_steps=32_768, fasttd3_dim=1024, updates=50, turns=5
)
CPU = Scale(model_size=1, sequences=4, plan_envs=1, fasttd3_steps=64, fasttd3_dim=64, updates=2, turns=2)


@dataclass(frozen=True, kw_only=True, slots=True)
class AgentsSettings(Settings):
    """Compares updates and planning to plain torch, and the replay buffer to TorchRL's.

    Attributes:
        parts: tdmpc2_update, tdmpc2_planning, fasttd3_update, replay.
        device: ``auto``, ``cpu``, ``cuda``.
        out: JSON file for the measurements.
    """

    device: str = "auto"


def parts(settings: AgentsSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    from roboverse_learn.training.device import resolve_device

    device = resolve_device(settings.device)
    torch.set_float32_matmul_precision("high")
    return measurements(GPU if device == "cuda" else CPU, device, compiled=device == "cuda")


def measurements(scale: Scale, device: str, *, compiled: bool) -> Mapping[str, Callable[[], Measurement]]:
    """Returns the measurements by name.

    Args:
        scale: How much.
        device: Torch device.
        compiled: Compile our side, and record it as CUDA graphs on a GPU.
    """
    size, goal = f"size {scale.model_size}", Goal(GOAL, applies=device == "cuda")
    against_torch = {
        "tdmpc2_update": (f"TD-MPC2, update, {size}, batch {scale.sequences}", tdmpc2_update, goal),
        "tdmpc2_planning": (
            f"TD-MPC2, planning for {scale.plan_envs} envs, {size}",
            tdmpc2_planning,
            Goal(),
        ),
        "fasttd3_update": (f"FastTD3, update, batch {scale.fasttd3_steps:,}", fasttd3_update, Goal()),
    }

    def compare(name: str, make: Callable[..., Call], goal: Goal) -> Measurement:
        sides = (make(scale, device, compiled=compiled), make(scale, device))
        return _compare(f"{name} on {device}, plain torch / ours", scale, device, sides, goal)

    found = {part: partial(compare, *named) for part, named in against_torch.items()}
    return {**found, "replay": partial(measure_replay, scale, device)}


def _compare(name: str, scale: Scale, device: str, sides: tuple[Call, Call], goal: Goal) -> Measurement:
    ours, baseline = (repeat(side, scale.updates) for side in sides)
    seconds = in_turns(ours, baseline, scale.turns, wait=cuda_wait(device))
    return measurement(name, seconds, goal, units=scale.updates)


def tdmpc2_update(scale: Scale, device: str, *, compiled: bool = False) -> Call:
    """Returns an update of a fresh TD-MPC2 on a fixed batch."""
    from policies.tdmpc2.update import Sequences, Updater

    policy = _tdmpc2(scale, device)
    graphs = compiled and device == "cuda"
    updater = Updater(policy.config, policy.model, [policy.discount], compile=compiled, cuda_graphs=graphs)
    horizon, batch = policy.config.horizon, scale.sequences
    given = Sequences(
        torch.randn(horizon + 1, batch, OBSERVED, device=device),
        torch.rand(horizon, batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(horizon, batch, device=device),
        torch.zeros(horizon, batch, device=device),
        torch.ones(horizon, batch, device=device),
    )
    return partial(updater.update, given)


def tdmpc2_planning(scale: Scale, device: str, *, compiled: bool = False) -> Call:
    """Returns the choice of actions in several environments at once."""
    from policies.tdmpc2.agent import Tdmpc2Agent

    policy = _tdmpc2(scale, device)
    graphs = compiled and device == "cuda"
    agent = Tdmpc2Agent(
        policy.config, policy.model, policy.discount, scale.plan_envs, compile=compiled, cuda_graphs=graphs
    )
    seen = torch.randn(scale.plan_envs, OBSERVED, device=device)
    first = torch.zeros(scale.plan_envs, dtype=torch.bool, device=device)
    return partial(agent.act, seen, first)


def _tdmpc2(scale: Scale, device: str) -> Any:
    from policies.tdmpc2.config import Tdmpc2Config
    from policies.tdmpc2.policy import Tdmpc2Policy

    config = Tdmpc2Config(model_size=scale.model_size)
    return Tdmpc2Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, EPISODE, device)


def fasttd3_update(scale: Scale, device: str, *, compiled: bool = False) -> Call:
    """Returns an update of a fresh FastTD3; every second one updates the actor."""
    from policies.fasttd3.config import FastTd3Config
    from policies.fasttd3.policy import FastTd3Policy
    from policies.fasttd3.update import Updater

    config = FastTd3Config(critic_dim=scale.fasttd3_dim, actor_dim=scale.fasttd3_dim // 2)
    policy = FastTd3Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, device)
    on_gpu = compiled and device == "cuda"
    updater = Updater(
        config, policy.actor, policy.critics, policy.norm, compile=compiled, cuda_graphs=on_gpu, bf16=on_gpu
    )
    batch = scale.fasttd3_steps
    given = (
        torch.randn(batch, OBSERVED, device=device),
        torch.rand(batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(batch, device=device),
        torch.full((batch,), config.discount, device=device),
        torch.randn(batch, OBSERVED, device=device),
    )
    return partial(updater.update, *given)


def measure_replay(scale: Scale, device: str) -> Measurement:
    """Compares batches of both replay buffers, sampled by one thread.

    Args:
        scale: How often; a batch is small, so 50 times as many are sampled as there are updates.
        device: Torch device.
    """
    from roboverse_learn.training.device import cpu_threads

    count, turns = 50 * scale.updates, 5 * scale.turns
    with cpu_threads(1, device):
        ours, theirs = (
            repeat(make(OBSERVED, ACTIONS, device), count) for make in (our_sequences, torchrl_slices)
        )
        seconds = in_turns(ours, theirs, turns, wait=cuda_wait(device))
    name = f"replay, {SEQUENCES} sequences of {HORIZON} on {device}, TorchRL's SliceSampler / ours"
    return measurement(name, seconds, Goal(), units=count)


def our_sequences(observed: int, actions: int, device: str) -> Callable[[], Any]:
    """Returns what samples a batch of :class:`roboverse_learn.training.rl.replay_buffer.ReplayBuffer`."""
    from roboverse_learn.training.rl.replay_buffer import ReplayBuffer, Transitions

    where = torch.device(device)
    buffer = ReplayBuffer(STEPS, ENVS, observed, actions, where, horizon=HORIZON)
    seen, done = torch.randn(ENVS, observed, device=where), torch.rand(ENVS, actions, device=where)
    nothing = torch.zeros(ENVS, device=where)
    step = Transitions(seen, done, nothing, nothing, seen)
    for moment in range(STEPS // ENVS):
        buffer.add(step, torch.full((ENVS,), (moment + 1) % EPISODE == 0, device=where))
    return partial(buffer.sequences, SEQUENCES)


def torchrl_slices(observed: int, actions: int, device: str) -> Callable[[], Any]:
    """Returns what samples a batch by TorchRL's ``SliceSampler``, whose slices are of one episode.

    Raises:
        MissingExtraError: if TorchRL is not installed.
    """
    try:
        from tensordict import TensorDict
        from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
        from torchrl.data.replay_buffers.samplers import SliceSampler
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            f"parts=[replay] compares with TorchRL, and the package '{error.name}' is not installed. "
            f"Install it with: {install_command('torchrl')}."
        ) from error

    # It looks for the episodes once: with cache_values=False it would do so for every batch.
    sampler = SliceSampler(slice_len=HORIZON, traj_key="episode", cache_values=True)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(STEPS, device=device), sampler=sampler, batch_size=SEQUENCES * HORIZON
    )
    fields = {
        "observation": torch.randn(STEPS, observed),
        "action": torch.rand(STEPS, actions),
        "reward": torch.zeros(STEPS),
        "terminated": torch.zeros(STEPS),
        "next_observation": torch.randn(STEPS, observed),
        "episode": torch.arange(STEPS) // EPISODE,
    }
    buffer.extend(TensorDict(fields, batch_size=[STEPS]).to(device))
    return buffer.sample


if __name__ == "__main__":
    sys.exit(program("agents", AgentsSettings, parts))
