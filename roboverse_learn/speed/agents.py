"""TD-MPC2, FastTD3 and the replay buffer, against plain torch and TorchRL: ``roboverse speed agents``.

Both sides of an update learn from the same batches of a humanoid's size (51 observations, 19 actions). On a
GPU our side is compiled and recorded as a CUDA graph, FastTD3 in bf16; plain torch computes in tf32. On a
CPU neither is compiled, and the sizes are small. The replay buffer is compared on any device to TorchRL's
``SliceSampler`` over the same episodes.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, cast, override

import torch

from envs.core.errors import MissingExtraError
from envs.core.extras import install_command
from roboverse_learn.speed.harness import NO_GOAL, Call, DeviceProgram, Goal, Measurement, part, scaled
from roboverse_learn.training.device import cpu_threads

OBSERVATION, OBSERVED, ACTIONS, EPISODE = "observation.environment_state", 51, 19, 1000
STEPS, ENVS, SEQUENCES, HORIZON = 100_000, 100, 256, 4
"""Size of the replay buffer, and of the batches sampled from it."""
GOAL = 2.0


def tdmpc2_update(sizes: "Agents", **form: Any) -> Call:
    """Returns an update of a fresh TD-MPC2 on a fixed batch."""
    from policies.tdmpc2.update import Sequences, Updater

    policy = _tdmpc2(sizes)
    updater = Updater(policy.config, policy.model, [policy.discount], **form)
    horizon, batch, device = policy.config.horizon, sizes.sequences, sizes.device
    given = Sequences(
        torch.randn(horizon + 1, batch, OBSERVED, device=device),
        torch.rand(horizon, batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(horizon, batch, device=device),
        torch.zeros(horizon, batch, device=device),
        torch.ones(horizon, batch, device=device),
    )
    return partial(updater.update, given)


def tdmpc2_planning(sizes: "Agents", **form: Any) -> Call:
    """Returns the choice of actions in several environments at once."""
    from policies.tdmpc2.agent import Tdmpc2Agent

    policy = _tdmpc2(sizes)
    agent = Tdmpc2Agent(policy.config, policy.model, policy.discount, sizes.plan_envs, **form)
    seen = torch.randn(sizes.plan_envs, OBSERVED, device=sizes.device)
    first = torch.zeros(sizes.plan_envs, dtype=torch.bool, device=sizes.device)
    return partial(agent.act, seen, first)


def _tdmpc2(sizes: "Agents") -> Any:
    from policies.tdmpc2.config import Tdmpc2Config
    from policies.tdmpc2.policy import Tdmpc2Policy

    config = Tdmpc2Config(model_size=cast(Any, sizes.model_size))
    return Tdmpc2Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, EPISODE, sizes.device)


def fasttd3_update(sizes: "Agents", **form: Any) -> Call:
    """Returns an update of a fresh FastTD3; every second one updates the actor."""
    from policies.fasttd3.config import FastTd3Config
    from policies.fasttd3.policy import FastTd3Policy
    from policies.fasttd3.update import Updater

    batch, device = sizes.fasttd3_steps, sizes.device
    config = FastTd3Config(critic_dim=sizes.fasttd3_dim, actor_dim=sizes.fasttd3_dim // 2)
    policy = FastTd3Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, device)
    bf16 = form["cuda_graphs"]
    updater = Updater(config, policy.actor, policy.critics, policy.norm, **form, bf16=bf16)
    given = (
        torch.randn(batch, OBSERVED, device=device),
        torch.rand(batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(batch, device=device),
        torch.full((batch,), config.discount, device=device),
        torch.randn(batch, OBSERVED, device=device),
    )
    return partial(updater.update, *given)


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


@dataclass(frozen=True, kw_only=True, slots=True)
class Agents(DeviceProgram):
    """Compares updates and planning to plain torch, and the replay buffer to TorchRL's.

    Attributes:
        parts: tdmpc2_update, tdmpc2_planning, fasttd3_update, replay.
        model_size: Size of TD-MPC2.
        sequences: Its sequences per update.
        plan_envs: Environments that are planned for at once.
        fasttd3_steps: Steps per update of FastTD3.
        fasttd3_dim: Width of its critics.
        updates: Timed calls of one turn; a replayed batch is small, so 50 times as many are sampled.
        turns: How often each side is timed.
        compile: Whether our side is compiled, which is recorded on a GPU too; None does so on a GPU.
    """

    model_size: int = scaled(gpu=5, cpu=1)
    sequences: int = scaled(gpu=256, cpu=4)
    plan_envs: int = scaled(gpu=64, cpu=1)
    fasttd3_steps: int = scaled(gpu=32_768, cpu=64)
    fasttd3_dim: int = scaled(gpu=1024, cpu=64)
    updates: int = scaled(gpu=50, cpu=2)
    turns: int = scaled(gpu=5, cpu=2)
    compile: bool | None = None

    @override
    def prepare(self) -> None:
        torch.set_float32_matmul_precision("high")

    @part("tdmpc2_update", "TD-MPC2, update, size {model_size}, batch {sequences}", tdmpc2_update, GOAL)
    @part("tdmpc2_planning", "TD-MPC2, planning for {plan_envs} envs, size {model_size}", tdmpc2_planning)
    @part("fasttd3_update", "FastTD3, update, batch {fasttd3_steps:,}", fasttd3_update)
    def against_torch(self, what: str, make: Callable[..., Call], least: float | None = None) -> Measurement:
        """Compares calls of what ``make`` returns, compiled and recorded, to those in plain torch."""
        goal = NO_GOAL if least is None else Goal(least, applies=self.on_gpu)
        compile = self.on_gpu if self.compile is None else self.compile
        ours = make(self, compile=compile, cuda_graphs=compile and self.on_gpu)
        plain = make(self, compile=False, cuda_graphs=False)
        name = f"{what.format_map(asdict(self))} on {self.device}, plain torch / ours"
        return self.compare(name, ours, plain, goal, calls=self.updates)

    @part("replay")
    def replay(self) -> Measurement:
        """Compares batches of both replay buffers, sampled by one thread."""
        device = self.device
        name = f"replay, {SEQUENCES} sequences of {HORIZON} on {device}, TorchRL's SliceSampler / ours"
        with cpu_threads(1, device):
            ours, theirs = (make(OBSERVED, ACTIONS, device) for make in (our_sequences, torchrl_slices))
            return self.compare(name, ours, theirs, turns=5 * self.turns, calls=50 * self.updates)
