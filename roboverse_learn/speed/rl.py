"""Reinforcement learning on a GPU: what our env and the adapters cost: ``roboverse speed rl``.

``throughput`` compares a step of PPO, updates included, on ``TorchVectorEnv`` to one on an env that is
written by hand on bare ``mujoco_warp``, with the same rsl_rl algorithm and network. The other parts compare
a step through an adapter to the env's own step within it. On a CPU a few envs show that the program works.
"""

import contextlib
import time
from dataclasses import dataclass
from functools import partial
from typing import Any, override

import numpy as np
import torch

from envs.spec import EnvSpec
from envs.torch_env import EnvStep, TorchVectorEnv
from policies.ppo.config import PpoConfig
from roboverse_learn.speed import harness
from roboverse_learn.speed.harness import Call, DeviceProgram, Goal, Measurement, part, part_each, scaled
from roboverse_learn.training.config import TrainConfig

TASK = "PickCube"
THROUGHPUT_GOAL, OVERHEAD_GOAL = 0.9, 1.05


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


def _through_rsl_rl(env: Any, actions: torch.Tensor) -> Call:
    from envs.adapters.rsl_rl import RslRlVecEnv

    return partial(RslRlVecEnv(env).step, actions)


def _through_sb3(env: Any, actions: torch.Tensor) -> Call:
    from envs.adapters.sb3 import Sb3VecEnv

    return partial(Sb3VecEnv(env).step, actions.cpu().numpy())


def _through_torchrl(env: Any, actions: torch.Tensor) -> Call:
    from envs.adapters.torchrl import TorchRlEnv

    adapted = TorchRlEnv(env)
    now = [adapted.reset()]

    def step() -> None:
        _, now[0] = adapted.step_and_maybe_reset(now[0].set("action", actions))

    return step


ADAPTERS = {"rsl_rl": _through_rsl_rl, "sb3": _through_sb3, "torchrl": _through_torchrl}
"""Libraries to what makes a step through their adapters."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Rl(DeviceProgram):
    """Compares a step of PPO to one on bare mujoco_warp, and a step through each adapter to the env's.

    Attributes:
        parts: throughput, rsl_rl, sb3, torchrl.
        num_envs: Environments.
        rollouts: Rollouts of PPO with their updates in one turn.
        turns: How often both sides of PPO are timed.
        steps: Steps through an adapter that are timed, after two that warm up.
    """

    num_envs: int = scaled(gpu=4096, cpu=8)
    rollouts: int = scaled(gpu=10, cpu=1)
    turns: int = scaled(gpu=5, cpu=1)
    steps: int = scaled(gpu=50, cpu=3)

    @override
    def prepare(self) -> None:
        torch.set_float32_matmul_precision("high" if self.on_gpu else "highest")

    def make_env(self) -> TorchVectorEnv:
        """Returns the env that is measured."""
        spec = EnvSpec(task=TASK, simulator="mujoco_warp", simulator_settings={"device": self.device})
        return spec.make_torch(self.num_envs, split="train", seed=0)

    @part("throughput")
    def throughput(self) -> Measurement:
        """Compares steps of PPO by ``rsl_rl``, updates included, on our env and on bare mujoco_warp."""
        from roboverse_learn.speed.bare_env import BareEnv

        config, env = PpoConfig(num_envs=self.num_envs), self.make_env()
        ours, bare = (_learning(each, config) for each in (env, BareEnv(self.num_envs, self.device)))
        where, calls = str(env.device), self.rollouts * config.num_steps
        name = f"a step of PPO, {self.num_envs} envs on {where}, bare mujoco_warp / ours"
        goal = Goal(THROUGHPUT_GOAL, applies=where != "cpu")
        with contextlib.closing(env):
            return self.compare(name, ours, bare, goal, calls=calls)

    @part_each(*ADAPTERS)
    def adapter(self, name: str) -> Measurement:
        """Compares a step through one of :data:`ADAPTERS` to the time that the env takes of it."""
        env = self.make_env()
        env.stagger()
        where = str(env.device)
        wait, step_env, inside_s = harness.cuda_wait(where), env.step, list[float]()

        def timed_step(actions: torch.Tensor) -> EnvStep:
            wait()
            started = time.perf_counter()
            done = step_env(actions)
            wait()
            inside_s.append(time.perf_counter() - started)
            return done

        env.step = timed_step
        generator = torch.Generator().manual_seed(0)
        actions = (torch.rand(self.num_envs, env.action_size, generator=generator) * 2.0 - 1.0).to(where)
        step = ADAPTERS[name](env, actions)
        step()
        step()
        inside_s.clear()
        whole_s = harness.seconds_of(step, self.steps, wait)
        env.close()
        title = f"a step through the adapter of {name}, {self.num_envs} envs on {where}, whole step / env"
        goal = Goal(OVERHEAD_GOAL, at_least=False, applies=where != "cpu")
        return harness.measurement(title, np.array([[whole_s, sum(inside_s)]]), goal, units=self.steps)
