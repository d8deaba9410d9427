"""Reinforcement learning on a GPU: what our env and the adapters cost: ``roboverse speed rl``.

``throughput`` compares a step of PPO, updates included, on ``TorchVectorEnv`` to one on an env that is
written by hand on bare ``mujoco_warp``, with the same rsl_rl algorithm and network. The other parts compare
a step through an adapter to the env's own step within it. On a CPU a few envs show that the program works.
"""

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from envs.spec import EnvSpec
from envs.torch_env import TorchVectorEnv
from policies.ppo.config import PpoConfig
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
from roboverse_learn.training.config import TrainConfig

TASK = "PickCube"
THROUGHPUT_GOAL, OVERHEAD_GOAL = 0.9, 1.05


@dataclass(frozen=True, kw_only=True, slots=True)
class RlSettings(Settings):
    """Compares a step of PPO to one on bare mujoco_warp, and a step through each adapter to the env's.

    Attributes:
        parts: throughput, rsl_rl, sb3, torchrl.
        device: ``auto``, ``cpu``, ``cuda``.
        num_envs: Environments; 0 takes 4,096 on a GPU and 8 on a CPU.
        out: JSON file for the measurements.
    """

    device: str = "auto"
    num_envs: int = 0


def parts(settings: RlSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    from envs.simulators.mujoco_warp.device import Device

    device, on_gpu = settings.device, Device(settings.device).is_cuda
    torch.set_float32_matmul_precision("high" if on_gpu else "highest")
    config = PpoConfig(num_envs=settings.num_envs or (4096 if on_gpu else 8))
    turns, rollouts, steps = (5, 10, 50) if on_gpu else (1, 1, 3)
    adapters = {
        name: partial(measure_adapter, name, config.num_envs, device, num_steps=steps) for name in ADAPTERS
    }
    return {"throughput": partial(measure_throughput, config, device, turns, rollouts), **adapters}


def make_env(num_envs: int, device: str) -> TorchVectorEnv:
    """Returns the env that is measured."""
    spec = EnvSpec(task=TASK, simulator="mujoco_warp", simulator_settings={"device": device})
    return spec.make_torch(num_envs, split="train", seed=0)


def measure_throughput(config: PpoConfig, device: str, turns: int, rollouts: int) -> Measurement:
    """Compares PPO's steps, updates included, on our env and on one on bare mujoco_warp.

    Args:
        config: Settings of PPO, with the backend ``rsl_rl``.
        device: Torch device, or ``auto``.
        turns: How often each side is timed.
        rollouts: Rollouts with their updates of one turn.

    Returns:
        Seconds per step of all environments.
    """
    from roboverse_learn.speed.bare_env import BareEnv

    envs: list[Any] = [make_env(config.num_envs, device), BareEnv(config.num_envs, device)]
    steps = rollouts * config.num_steps
    where = str(envs[0].device)
    ours, bare = (repeat(_learning(env, config), steps) for env in envs)
    seconds = in_turns(ours, bare, turns, wait=cuda_wait(where))
    for env in envs:
        env.close()
    name = f"a step of PPO, {config.num_envs} envs on {where}, bare mujoco_warp / ours"
    return measurement(name, seconds, Goal(THROUGHPUT_GOAL, applies=where != "cpu"), units=steps)


def _learning(env: Any, config: PpoConfig) -> Call:
    """Returns one step of PPO on an env, with the update that may be due after it."""
    from policies.ppo.policy import PpoPolicy
    from roboverse_learn.training.rl.loop import OBSERVATION
    from roboverse_learn.training.rl.ppo import learner

    policy = PpoPolicy(config, {OBSERVATION: env.observation_size}, env.action_size, env.device)
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


class _TimedEnv:
    """An env that sums up the time of its steps."""

    def __init__(self, env: TorchVectorEnv, wait: Call) -> None:
        self._env, self._wait, self.inside_s = env, wait, 0.0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)

    def step(self, actions: torch.Tensor) -> Any:
        self._wait()
        started = time.perf_counter()
        done = self._env.step(actions)
        self._wait()
        self.inside_s += time.perf_counter() - started
        return done


def measure_adapter(name: str, num_envs: int, device: str, *, num_steps: int) -> Measurement:
    """Compares a step through an adapter to the time that the env takes of it.

    Args:
        name: One of :data:`ADAPTERS`.
        num_envs: Environments.
        device: Torch device, or ``auto``.
        num_steps: Steps that are timed, after two that warm up.
    """
    env = make_env(num_envs, device)
    env.stagger()
    where = str(env.device)
    wait = cuda_wait(where) or (lambda: None)
    timed = _TimedEnv(env, wait)
    step = ADAPTERS[name](timed)
    repeat(step, 2)()
    timed.inside_s = 0.0
    wait()
    started = time.perf_counter()
    repeat(step, num_steps)()
    wait()
    seconds = np.array([[time.perf_counter() - started, timed.inside_s]])
    env.close()
    title = f"a step through the adapter of {name}, {num_envs} envs on {where}, whole step / env"
    goal = Goal(OVERHEAD_GOAL, at_least=False, applies=where != "cpu")
    return measurement(title, seconds, goal, units=num_steps)


def _through_rsl_rl(env: Any) -> Call:
    from envs.adapters.rsl_rl import RslRlVecEnv

    return partial(RslRlVecEnv(env).step, _random_actions(env))


def _through_sb3(env: Any) -> Call:
    from envs.adapters.sb3 import Sb3VecEnv

    return partial(Sb3VecEnv(env).step, _random_actions(env).cpu().numpy())


def _through_torchrl(env: Any) -> Call:
    from envs.adapters.torchrl import TorchRlEnv

    adapter, actions = TorchRlEnv(env), _random_actions(env)
    now = [adapter.reset()]

    def step() -> None:
        _, now[0] = adapter.step_and_maybe_reset(now[0].set("action", actions))

    return step


ADAPTERS = {"rsl_rl": _through_rsl_rl, "sb3": _through_sb3, "torchrl": _through_torchrl}
"""Libraries to what makes a step through their adapters."""


def _random_actions(env: Any) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return (torch.rand(env.num_envs, env.action_size, generator=generator) * 2.0 - 1.0).to(env.device)


if __name__ == "__main__":
    sys.exit(program("rl", RlSettings, parts))
