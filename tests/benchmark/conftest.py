"""A small env and a small policy with the runner's interface, and results of invented records."""

import os
from collections import Counter
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")

JOINTS = 9


@dataclass
class StepResult:
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    success: np.ndarray


class PointEnv:
    """A point in joint space that follows its action; an episode succeeds when it rests at its goal.

    Goals and starts follow from the episode alone. Every env counts how often it was observed.
    """

    simulator, renderer = "point", "flat"
    channels, not_shown = ("task",), ("metallic",)

    def __init__(self, num_envs=1, *, horizon=24, truncates=True, split_size=50):
        self.num_envs = num_envs
        self.task = SimpleNamespace(name="Reach", max_episode_steps=horizon)
        self.max_episode_steps = horizon
        self.single_action_space = SimpleNamespace(shape=(JOINTS,))
        self.split_indices = np.arange(100, 100 + split_size)
        self.observed = Counter()
        self.observe_batches = []
        self.closed = False
        self._truncates = truncates
        self._episode = np.full(num_envs, -1)
        self._t = np.zeros(num_envs, dtype=int)
        self._x = np.zeros((num_envs, JOINTS))
        self._goal = np.zeros((num_envs, JOINTS))

    def _check(self, env_ids):
        assert list(env_ids) == sorted(set(env_ids)), "simulators take sorted environments, each once"

    def reset_envs(self, env_ids, episodes):
        self._check(env_ids)
        for env_id, episode in zip(env_ids, episodes, strict=True):
            rng = np.random.default_rng(int(episode))
            self._x[env_id] = rng.uniform(-1, 1, JOINTS)
            self._goal[env_id] = rng.uniform(-0.5, 0.5)
            self._episode[env_id], self._t[env_id] = episode, 0

    def observe(self, env_ids):
        self._check(env_ids)
        self.observe_batches.append([int(env_id) for env_id in env_ids])
        self.observed.update(int(episode) for episode in self._episode[env_ids])
        state = np.concatenate([self._x[env_ids, :8], self._goal[env_ids, :1]], axis=1).astype(np.float32)
        observation: dict[str, np.ndarray] = {"observation.state": state}
        observation["observation.images.front"] = np.stack([self.image(env_id) for env_id in env_ids])
        return observation

    def image(self, env_id):
        image = np.zeros((16, 16, 3), np.uint8)
        image[..., 0] = self._t[env_id] * 10
        return image

    def step_envs(self, env_ids, actions):
        self._check(env_ids)
        self._x[env_ids] += 0.4 * (actions - self._x[env_ids])
        self._t[env_ids] += 1
        distance = np.abs(self._x[env_ids] - self._goal[env_ids]).max(axis=1)
        success = distance < 0.1
        over = self._t[env_ids] >= self.task.max_episode_steps
        truncated = over & ~success if self._truncates else np.zeros_like(success)
        return StepResult(reward=-distance, terminated=success, truncated=truncated, success=success)

    def initial_state_hash(self, env_id):
        return f"{int(self._episode[env_id]):016x}"

    def instruction(self, env_id):
        return f"Reach goal {int(self._episode[env_id])}."

    def close(self):
        self.closed = True


class NoisyPolicy:
    """Goes to the goal, with noise from each episode's own generator and in the mean of its history."""

    batch_invariant = True

    def __init__(self, n_action_steps=5, n_obs_steps=1, noise=0.2):
        self.n_action_steps, self.n_obs_steps, self._noise = n_action_steps, n_obs_steps, noise
        self.batches = []

    def act(self, observation, generators=()):
        import torch

        state = observation["observation.state"]
        self.batches.append(state.shape)
        newest = state if self.n_obs_steps == 1 else state.mean(axis=1)
        noise = np.stack(
            [
                torch.randn(self.n_action_steps, JOINTS, generator=g, dtype=torch.float64).numpy()
                for g in generators
            ]
        )
        return newest[:, None, -1:] + self._noise * noise


@pytest.fixture
def point_env():
    return PointEnv


@pytest.fixture
def noisy_policy():
    return NoisyPolicy


@pytest.fixture
def make_records():
    """Returns a function that invents the records of a protocol from a rate per level."""
    from benchmark.records import EpisodeRecord

    def make(protocol, *, policy="act", rates=(0.9, 0.6, 0.4, 0.2), run_seed=0, task="PickCube", **shared):
        records = []
        for cell in protocol.cells():
            level = 2 if cell.level is None else cell.level
            rng = np.random.default_rng([run_seed, level, cell.split == "test", cell.only is not None])
            for index in range(protocol.episodes):
                success = bool(rng.random() < rates[level])
                length = int(rng.integers(40, 120)) if success else 250
                records.append(
                    EpisodeRecord(
                        task=task,
                        policy=policy,
                        level=cell.level,
                        only=cell.only,
                        channels=("task", cell.only) if cell.only else ("task",),
                        split=cell.split,
                        episode=index + (9000 if cell.split == "test" else 0),
                        seed=protocol.seed,
                        initial_state_hash=f"{index:015x}{level}",
                        success=success,
                        length=length,
                        episode_return=float(np.float32(rng.normal())),
                        wall_time_s=float(rng.random()),
                        **({"simulator": "mujoco", "renderer": "warp"} | shared),
                        not_shown=("metallic",) if level == 3 else (),
                        versions={"mujoco": "4.0.0"},
                        instruction_test=cell.instruction_test,
                    )
                )
        return tuple(records)

    return make


@pytest.fixture
def make_result(make_records):
    """Returns a function that invents a whole result."""
    from benchmark.protocol import Protocol
    from benchmark.records import Checkpoint, Git, Machine, Result
    from envs.spec import EnvSpec

    def make(
        *,
        protocol=None,
        policy="act",
        seed=0,
        run=None,
        task="PickCube",
        rates=(0.9, 0.6, 0.4, 0.2),
        **changes,
    ):
        protocol = protocol or Protocol(episodes=4)
        shared = {key: changes[key] for key in ("simulator", "renderer") if key in changes}
        env = {key: changes.pop(key) for key in EnvSpec.__dataclass_fields__ if key in changes}
        values = {
            "run": run or f"{policy}-s{seed}",
            "created": "2026-03-01T12:00:00Z",
            "protocol": protocol,
            "env": EnvSpec(**{"task": task, "image_size": 128} | env),
            "max_episode_steps": 250,
            "control_hz": 20.0,
            "policy": policy,
            "train_level": 0,
            "recipe": f"{policy}_v1",
            "seed": seed,
            "checkpoint": Checkpoint(step=2000, hash="ab" * 32),
            "dataset_hash": "cd" * 8,
            "demonstrations": 100,
            "git": Git(sha="0123456789abcdef0123456789abcdef01234567", dirty=False),
            "command": f"python roboverse_learn/train.py policy={policy} task=PickCube seed={seed}",
            "config": {"policy": {"name": policy, "chunk_size": 20}, "seed": seed},
            "machine": Machine(device="cpu", cpu_count=2),
            "versions": {"mujoco": "4.0.0"},
            "records": make_records(protocol, policy=policy, rates=rates, run_seed=seed, task=task, **shared),
        }
        return Result(**(values | changes))

    return make


@pytest.fixture
def publish(make_result, tmp_path):
    """Returns a function that writes an invented result into its place under ``tmp_path``."""

    from benchmark.results import result_path, write_result

    def write(**kwargs):
        result = make_result(**kwargs)
        path = result_path(tmp_path, result)
        write_result(path, result)
        return path

    return write
