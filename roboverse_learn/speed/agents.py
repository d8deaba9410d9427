"""Updates and planning of TD-MPC2, and updates of FastTD3: as training runs them, against plain torch.

And the batches that TD-MPC2 learns from: those of our replay buffer against TorchRL's.

Both sides learn from the same batches of a humanoid's size (51 numbers observed, 19 actions). On a GPU ours
is compiled and recorded as a CUDA graph, FastTD3 in bf16; plain torch computes in tf32. On a CPU neither is
compiled, and the sizes are small: it shows that the benchmark runs. ``parts=[replay]`` tells as much there.
"""

import json
import logging
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

from envs.core.arguments import run_program
from envs.core.errors import unknown_name
from roboverse_learn.speed.throughput import Measurement

log = logging.getLogger(__name__)

OBSERVATION, OBSERVED, ACTIONS, EPISODE = "observation.environment_state", 51, 19, 1000
PARTS = ("tdmpc2_update", "tdmpc2_planning", "fasttd3_update", "replay")
GOAL = 2.0
WARMUP = 8
"""Calls before the clock: compilation, then the recording of graphs, of which FastTD3 has two."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """How much is measured.

    Attributes:
        model_size: Size of TD-MPC2.
        tdmpc2_batch: Its sequences per update.
        plan_envs: Environments that are planned for at once.
        fasttd3_batch: Steps per update of FastTD3.
        fasttd3_dim: Width of its critics; the actor's is half of it.
        updates: Timed calls of one turn.
        turns: How often either side is timed.
    """

    model_size: Any
    tdmpc2_batch: int
    plan_envs: int
    fasttd3_batch: int
    fasttd3_dim: int
    updates: int
    turns: int


GPU = Scale(
    model_size=5,
    tdmpc2_batch=256,
    plan_envs=64,
    fasttd3_batch=32_768,
    fasttd3_dim=1024,
    updates=50,
    turns=5,
)
CPU = Scale(model_size=1, tdmpc2_batch=4, plan_envs=1, fasttd3_batch=64, fasttd3_dim=64, updates=2, turns=2)


@dataclass(frozen=True, kw_only=True, slots=True)
class AgentsBenchmark:
    """``python -m roboverse_learn.speed.agents``.

    Attributes:
        parts: What is measured: tdmpc2_update, tdmpc2_planning, fasttd3_update, replay.
        device: ``auto``, ``cpu``, ``cuda``.
        out: File for what was measured, as JSON; empty writes none.
    """

    parts: tuple[str, ...] = PARTS
    device: str = "auto"
    out: str = ""

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise unknown_name("part of this benchmark", part, PARTS)


def measure(scale: Scale, device: str, *, compiled: bool, parts: Sequence[str] = PARTS) -> list[Measurement]:
    """Measures updates, planning and the replay buffer.

    Args:
        scale: How much.
        device: Torch device.
        compiled: Compile ours, and record it as CUDA graphs.
        parts: Which of :data:`PARTS`.

    Returns:
        Seconds per call; the ratio is the other's time over ours.
    """
    size, batch = f"size {scale.model_size}", f"batch {scale.tdmpc2_batch}"
    named = {
        "tdmpc2_update": (f"TD-MPC2, update, {size}, {batch}", tdmpc2_update),
        "tdmpc2_planning": (f"TD-MPC2, planning for {scale.plan_envs} envs, {size}", tdmpc2_planning),
        "fasttd3_update": (f"FastTD3, update, batch {scale.fasttd3_batch:,}", fasttd3_update),
    }

    def compare(part: str) -> Measurement:
        if part == "replay":
            return _replay(scale, device)
        name, make = named[part]
        return _compare(name, scale, device, make(scale, device, compiled=compiled), make(scale, device))

    return [compare(part) for part in parts]


def tdmpc2_update(scale: Scale, device: str, *, compiled: bool = False) -> Callable[[], Any]:
    """Returns an update of a fresh TD-MPC2 on a batch that stays the same."""
    import torch

    from policies.tdmpc2.update import Sequences, Updater

    policy = _tdmpc2(scale, device)
    graphs = compiled and device == "cuda"
    updater = Updater(policy.config, policy.model, [policy.discount], compile=compiled, cuda_graphs=graphs)
    horizon, batch = policy.config.horizon, scale.tdmpc2_batch
    given = Sequences(
        torch.randn(horizon + 1, batch, OBSERVED, device=device),
        torch.rand(horizon, batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(horizon, batch, device=device),
        torch.zeros(horizon, batch, device=device),
        torch.ones(horizon, batch, device=device),
    )
    return lambda: updater.update(given)


def tdmpc2_planning(scale: Scale, device: str, *, compiled: bool = False) -> Callable[[], Any]:
    """Returns the choice of actions in several environments at once."""
    import torch

    from policies.tdmpc2.agent import Tdmpc2Agent

    policy = _tdmpc2(scale, device)
    graphs = compiled and device == "cuda"
    agent = Tdmpc2Agent(
        policy.config, policy.model, policy.discount, scale.plan_envs, compile=compiled, cuda_graphs=graphs
    )
    seen = torch.randn(scale.plan_envs, OBSERVED, device=device)
    first = torch.zeros(scale.plan_envs, dtype=torch.bool, device=device)
    return lambda: agent.act(seen, first)


def fasttd3_update(scale: Scale, device: str, *, compiled: bool = False) -> Callable[[], Any]:
    """Returns an update of a fresh FastTD3; every second one updates the actor."""
    import torch

    from policies.fasttd3.config import FastTd3Config
    from policies.fasttd3.policy import FastTd3Policy
    from policies.fasttd3.update import Updater

    config = FastTd3Config(critic_dim=scale.fasttd3_dim, actor_dim=scale.fasttd3_dim // 2)
    policy = FastTd3Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, device)
    on_gpu = compiled and device == "cuda"
    updater = Updater(
        config, policy.actor, policy.critics, policy.norm, compile=compiled, cuda_graphs=on_gpu, bf16=on_gpu
    )
    batch = scale.fasttd3_batch
    given = (
        torch.randn(batch, OBSERVED, device=device),
        torch.rand(batch, ACTIONS, device=device) * 2 - 1,
        torch.rand(batch, device=device),
        torch.full((batch,), config.discount, device=device),
        torch.randn(batch, OBSERVED, device=device),
    )
    return lambda: updater.update(*given)


def _replay(scale: Scale, device: str) -> Measurement:
    """Draws batches by one thread, and so many that small ones are told apart."""
    from roboverse_learn.speed.replay import HORIZON, SEQUENCES, our_sequences, torchrl_slices
    from roboverse_learn.training.device import cpu_threads

    name = f"Replay, {SEQUENCES} sequences of {HORIZON}"
    draws = replace(scale, updates=50 * scale.updates, turns=5 * scale.turns)
    with cpu_threads(1, device):
        ours, theirs = (make(OBSERVED, ACTIONS, device) for make in (our_sequences, torchrl_slices))
        return _compare(name, draws, device, ours, theirs, against="TorchRL's SliceSampler", goal="reported")


def _tdmpc2(scale: Scale, device: str) -> Any:
    from policies.tdmpc2.config import Tdmpc2Config
    from policies.tdmpc2.policy import Tdmpc2Policy

    config = Tdmpc2Config(model_size=scale.model_size)
    return Tdmpc2Policy.create(config, {OBSERVATION: OBSERVED}, ACTIONS, EPISODE, device)


def _compare(
    name: str,
    scale: Scale,
    device: str,
    ours: Callable[[], Any],
    theirs: Callable[[], Any],
    *,
    against: str = "plain torch",
    goal: str = f"goal ≥ {GOAL:.1f} on a GPU",
) -> Measurement:
    """Times both in turns."""
    for call in (ours, theirs):
        _time(call, WARMUP if device == "cuda" else 2, device)
    times = [
        (_time(ours, scale.updates, device), _time(theirs, scale.updates, device)) for _ in range(scale.turns)
    ]
    return Measurement(
        name=f"{name} on {device}, {against} / ours",
        ours_s=median(mine for mine, _ in times),
        baseline_s=median(other for _, other in times),
        ratio=median(other / mine for mine, other in times),
        goal=goal,
    )


def _time(call: Callable[[], Any], count: int, device: str) -> float:
    """Returns the seconds of a call, of several that are waited for together."""
    import torch

    wait = torch.cuda.synchronize if device == "cuda" else lambda: None
    wait()
    started = time.perf_counter()
    for _ in range(count):
        call()
    wait()
    return (time.perf_counter() - started) / count


def main(words: Sequence[str] | None = None) -> int:
    """Logs every measurement; the exit code is 1 where TD-MPC2's update misses its goal on a GPU."""
    return run_program("python -m roboverse_learn.speed.agents", AgentsBenchmark, _measure_all, words)


def _measure_all(given: AgentsBenchmark) -> int:
    import torch

    from roboverse_learn.training.device import resolve_device

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    device = resolve_device(given.device)
    on_gpu = device == "cuda"
    torch.set_float32_matmul_precision("high")
    measurements = measure(GPU if on_gpu else CPU, device, compiled=on_gpu, parts=given.parts)
    for measurement in measurements:
        log.info("%s", measurement)
        log.info("  %.1f per second; the other %.1f", 1 / measurement.ours_s, 1 / measurement.baseline_s)
    if given.out:
        rows = [asdict(measurement) for measurement in measurements]
        out = Path(given.out)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(json.dumps({"device": device, "rows": rows}, indent=2), encoding="utf-8")
    updates = [each for each in measurements if each.name.startswith("TD-MPC2, update")]
    return int(on_gpu and any(each.ratio < GOAL for each in updates))


if __name__ == "__main__":
    sys.exit(main())
