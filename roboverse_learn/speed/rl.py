"""Learning by reward on a GPU: what our env and the adapters cost, and how soon PPO picks the cube.

Three parts, each in a line or two of the output: PPO's environment steps per second with ``TorchVectorEnv``
against an env that is written by hand on bare ``mujoco_warp`` (the same rsl_rl algorithm and network);
what each adapter adds to a step; and the seconds of training until PPO solves 95 % of its episodes, with
the success on test episodes. On a CPU a few worlds show that the program works.
"""

import json
import logging
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any

import torch

from envs.core.arguments import run_program
from envs.core.errors import unknown_name
from envs.torch_env import TorchVectorEnv
from policies.ppo.config import PpoConfig
from roboverse_learn.speed.solving import LEARNING_RATE, SECONDS_GOAL, Solved, make_env, solve
from roboverse_learn.speed.throughput import Measurement
from roboverse_learn.training.config import TrainConfig

log = logging.getLogger(__name__)

THROUGHPUT_GOAL, OVERHEAD_GOAL = 0.9, 0.05
PARTS = ("throughput", "adapters", "solve")


@dataclass(frozen=True, kw_only=True, slots=True)
class RlBenchmark:
    """``python -m roboverse_learn.speed.rl``.

    Attributes:
        parts: What is measured: throughput, adapters, solve.
        device: ``auto``, ``cpu``, ``cuda``.
        worlds: Environments; 0 takes 4,096 on a GPU and 8 on a CPU.
        seconds: Longest training until the cube is picked; 0 takes 60 on a GPU and 5 on a CPU.
        backend: Library of that training: rsl_rl, sb3 or torchrl.
        seeds: Seeds of that training, one run each.
        policy: Settings of PPO that differ from its defaults, as in policy={gamma: 0.8}.
        lr: Its learning rate.
        out: Folder for what was measured, as JSON, and the curves; empty keeps nothing.
    """

    parts: tuple[str, ...] = PARTS
    device: str = "auto"
    worlds: int = 0
    seconds: float = 0.0
    backend: str = "rsl_rl"
    seeds: tuple[int, ...] = (0,)
    policy: dict[str, Any] = field(default_factory=dict)
    lr: float = LEARNING_RATE
    out: str = ""

    def __post_init__(self) -> None:
        for part in self.parts:
            if part not in PARTS:
                raise unknown_name("part of this benchmark", part, PARTS)


def measure_throughput(config: PpoConfig, device: str, *, turns: int, rollouts: int) -> Measurement:
    """Compares PPO's steps, updates included, on our env and on one that is written by hand.

    Args:
        config: Settings of PPO, with the backend ``rsl_rl``.
        device: Torch device, or ``auto``.
        turns: How often either side is timed, after one turn that warms up.
        rollouts: Rollouts with their updates of a turn.

    Returns:
        Seconds per step of all environments; the ratio is the bare time over ours.
    """
    from roboverse_learn.speed.bare_env import BareEnv

    envs: list[Any] = [make_env(config.num_envs, device), BareEnv(config.num_envs, device)]
    runs = [_learning(env, config) for env in envs]
    times = []
    for turn in range(turns + 1):
        seconds = [0.0, 0.0]
        for which in (turn % 2, 1 - turn % 2):
            seconds[which] = _timed(runs[which], rollouts * config.num_steps, envs[0].device)
        times.append(seconds)
    for env in envs:
        env.close()
    ours, bare = zip(*times[1:], strict=True)
    return Measurement(
        name=f"a step of PPO, {config.num_envs} worlds on {envs[0].device}, bare mujoco_warp / ours",
        ours_s=median(ours),
        baseline_s=median(bare),
        ratio=median(b / o for b, o in zip(bare, ours, strict=True)),
        goal=f"goal ≥ {THROUGHPUT_GOAL:.2f} on a GPU",
    )


def _learning(env: Any, config: PpoConfig) -> Callable[[], None]:
    """Returns one step of PPO on an env, after which an update may be due."""
    from policies.ppo.policy import PpoPolicy
    from roboverse_learn.training.rl.ppo import learner

    policy = PpoPolicy(config, {learner.OBSERVATION: env.observation_size}, env.action_size, env.device)
    algorithm = learner.make_algorithm(policy, env, TrainConfig(lr=3e-4, grad_clip=1.0))
    now = [env.reset(), torch.ones(env.num_envs, dtype=torch.bool, device=env.device)]
    env.stagger()

    def step() -> None:
        action = algorithm.act(*now)
        done = env.step(action)
        algorithm.store(now[0], action, done)
        now[:] = done.obs, done.terminated | done.truncated
        if algorithm.must_learn():
            algorithm.learn()

    return step


def _timed(step: Callable[[], object], count: int, device: torch.device) -> float:
    """Returns the seconds per call."""
    _wait(device)
    started = time.perf_counter()
    for _ in range(count):
        step()
    _wait(device)
    return (time.perf_counter() - started) / count


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)


class _Watched:
    """An env that notes how long its steps take."""

    def __init__(self, env: TorchVectorEnv) -> None:
        self._env, self.inside_s = env, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def step(self, actions: torch.Tensor) -> Any:
        _wait(self._env.device)
        started = time.perf_counter()
        done = self._env.step(actions)
        _wait(self._env.device)
        self.inside_s += time.perf_counter() - started
        return done


def measure_adapters(num_envs: int, device: str, *, num_steps: int) -> list[Measurement]:
    """Measures what each adapter adds to a step of the batched env.

    Returns:
        For each adapter seconds per step with it and within the env; the ratio is what it adds over the
        latter.
    """
    env = make_env(num_envs, device)
    env.stagger()
    found = []
    for name, make in _ADAPTERS.items():
        watched = _Watched(env)
        step = make(watched)
        _timed(step, 2, env.device)
        watched.inside_s = 0.0
        total = _timed(step, num_steps, env.device)
        inside = watched.inside_s / num_steps
        found.append(
            Measurement(
                name=f"a step through the adapter of {name}, {num_envs} worlds on {env.device}, added time",
                ours_s=total,
                baseline_s=inside,
                ratio=(total - inside) / inside,
                goal=f"goal ≤ {OVERHEAD_GOAL:.2f} on a GPU",
            )
        )
    env.close()
    return found


def _through_rsl_rl(env: Any) -> Callable[[], object]:
    from envs.adapters.rsl_rl import RslRlVecEnv

    adapter, actions = RslRlVecEnv(env), _random_actions(env)
    return lambda: adapter.step(actions)


def _through_sb3(env: Any) -> Callable[[], object]:
    from envs.adapters.sb3 import Sb3VecEnv

    adapter, actions = Sb3VecEnv(env), _random_actions(env).cpu().numpy()
    return lambda: adapter.step(actions)


def _through_torchrl(env: Any) -> Callable[[], object]:
    from envs.adapters.torchrl import TorchRlEnv

    adapter, actions = TorchRlEnv(env), _random_actions(env)
    now = [adapter.reset()]

    def step() -> None:
        _, now[0] = adapter.step_and_maybe_reset(now[0].set("action", actions))

    return step


_ADAPTERS = {"rsl_rl": _through_rsl_rl, "sb3": _through_sb3, "torchrl": _through_torchrl}


def _random_actions(env: Any) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    drawn = torch.rand(env.num_envs, env.action_size, generator=generator) * 2.0 - 1.0
    return drawn.to(env.device)


def main(words: Sequence[str] | None = None) -> int:
    """Logs every measurement; the exit code is 1 where a GPU misses a goal."""
    return run_program("python -m roboverse_learn.speed.rl", RlBenchmark, _measure_all, words)


def _measure_all(given: RlBenchmark) -> int:
    from envs.simulators.mujoco_warp.device import Device

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    on_gpu = Device(given.device).is_cuda
    torch.set_float32_matmul_precision("high" if on_gpu else "highest")
    config = PpoConfig(num_envs=given.worlds or (4096 if on_gpu else 8), **given.policy)
    measured: list[Any] = []
    missed = False
    if "throughput" in given.parts:
        scale = {"turns": 5, "rollouts": 10} if on_gpu else {"turns": 1, "rollouts": 1}
        measured.append(measure_throughput(config, given.device, **scale))
        log.info("%s", measured[-1])
        missed |= measured[-1].ratio < THROUGHPUT_GOAL
    if "adapters" in given.parts:
        for each in measure_adapters(config.num_envs, given.device, num_steps=50 if on_gpu else 3):
            log.info("%s", each)
            measured.append(each)
            missed |= each.ratio > OVERHEAD_GOAL
    if "solve" in given.parts:
        for seed in given.seeds:
            solved = _solve(replace(config, backend=given.backend), given, on_gpu, seed)  # type: ignore[arg-type]
            log.info("%s", solved)
            measured.append(solved)
            missed |= solved.reached_s is None or solved.reached_s > SECONDS_GOAL
    if given.out:
        path = Path(given.out) / "rl.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps([asdict(each) for each in measured], indent=1) + "\n", encoding="utf-8")
    return int(on_gpu and missed)


def _solve(config: PpoConfig, given: RlBenchmark, on_gpu: bool, seed: int) -> Solved:
    """Trains in a folder that is kept if one was named."""
    seconds = given.seconds or (SECONDS_GOAL if on_gpu else 5.0)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(given.out or scratch) / f"{config.backend}-seed{seed}"
        return solve(config, given.device, seconds, folder, seed, lr=given.lr)


if __name__ == "__main__":
    sys.exit(main())
