"""Replay buffer on the device of training.

Shapes: T time steps, N environments, D observation, A action, B samples, H steps of a sequence.

A batch is one gather of each field, and nothing waits for a GPU. It takes half the time of TorchRL's
``SliceSampler`` on a CPU (``roboverse speed agents parts=[replay] device=cpu``), and
sequences may go beyond an episode's end, which is marked.
"""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from envs.core.errors import CheckpointError, ConfigError

_FIELDS = ("observation", "action", "reward", "terminated", "next_observation")


class Transitions(NamedTuple):
    """Single steps.

    Attributes:
        observation: (B, D).
        action: (B, A).
        reward: (B,).
        terminated: 1 where the episode ended for good, else 0, (B,).
        next_observation: (B, D), of the same episode even where that was its end.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    terminated: Tensor
    next_observation: Tensor


class Returns(NamedTuple):
    """Transitions of a few steps.

    Attributes:
        observation: (B, D).
        action: (B, A).
        reward: Discounted sum of the rewards of those steps (B,).
        discount: What the value of ``next_observation`` counts for: 0 where the episode ended for good,
            (B,).
        next_observation: The last observation of those steps (B, D).
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    discount: Tensor
    next_observation: Tensor


class StoredSequences(NamedTuple):
    """Pieces of episodes, time first.

    Attributes:
        observations: (H + 1, B, D).
        actions: (H, B, A).
        rewards: (H, B).
        terminated: 1 where the episode ended for good after the action, else 0, (H, B).
        valid: 1 where the step is of the episode that the sequence began in, 0 after its end, (H, B).
        env: The environment that each is of, (B,) int64.
    """

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    terminated: Tensor
    valid: Tensor
    env: Tensor


class ReplayBuffer:
    """A ring of the last T steps of N environments.

    Args:
        capacity: Steps that are kept, over all environments together.
        num_envs: N.
        observation_size: D.
        action_size: A.
        device: Where it is kept.
        horizon: H of the sequences; 1 where single steps are sampled.
    """

    def __init__(
        self,
        capacity: int,
        num_envs: int,
        observation_size: int,
        action_size: int,
        device: torch.device,
        horizon: int = 1,
    ) -> None:
        self.length = capacity // num_envs  # T
        if self.length <= horizon:
            raise ConfigError(
                f"policy.buffer_size={capacity} holds {self.length} step(s) of each of {num_envs} "
                f"environments. Take {num_envs * (horizon + 1)} at least, or a smaller policy.num_envs."
            )
        self.num_envs, self.horizon, self.device = num_envs, horizon, device
        self.next, self.filled = 0, 0
        shape = (self.length, num_envs)
        self.storage = {
            "observation": torch.zeros(*shape, observation_size, device=device),
            "action": torch.zeros(*shape, action_size, device=device),
            "reward": torch.zeros(shape, device=device),
            "terminated": torch.zeros(shape, device=device),
            "over": torch.zeros(shape, dtype=torch.bool, device=device),
            "next_observation": torch.zeros(*shape, observation_size, device=device),
        }

    def __len__(self) -> int:
        return self.filled * self.num_envs

    @property
    def capacity(self) -> int:
        """Steps of all environments that fit."""
        return self.length * self.num_envs

    def add(self, transitions: Transitions, over: Tensor) -> None:
        """Adds one step of every environment.

        Args:
            transitions: The step, B = N.
            over: Whether the episode is over, whatever ended it, (N,) bool.
        """
        row, storage = self.next, self.storage
        for key, value in zip(_FIELDS, transitions, strict=True):
            storage[key][row] = value
        storage["over"][row] = over
        self.filled = min(self.filled + 1, self.length)
        self.next = (row + 1) % self.length

    def returns(self, num: int, steps: int, discount: float) -> Returns:
        """Returns ``num`` transitions, sampled uniformly from all that are stored.

        Args:
            num: B.
            steps: Steps that are summed; fewer where the episode ends or what is kept does.
            discount: Discount per step.
        """
        stored = {key: value.flatten(0, 1) for key, value in self.storage.items()}
        first = torch.randint(len(self), (num,), device=self.device)
        last, total = first, stored["reward"][first]
        weight = torch.full_like(total, discount)
        for _ in range(1, steps):
            after = (last + self.num_envs) % (self.length * self.num_envs)
            goes_on = ~stored["over"][last] & (after // self.num_envs != self.next)
            total = total + torch.where(goes_on, weight * stored["reward"][after], 0.0)
            weight = torch.where(goes_on, weight * discount, weight)
            last = torch.where(goes_on, after, last)
        return Returns(
            stored["observation"][first],
            stored["action"][first],
            total,
            weight * (1.0 - stored["terminated"][last]),
            stored["next_observation"][last],
        )

    def sequences(self, num: int) -> StoredSequences:
        """Returns ``num`` sequences of H steps, sampled uniformly from all that are stored.

        They begin anywhere in an episode, its last steps included, or those would be sampled H times less
        often than all others; steps after the episode's end are marked.
        """
        oldest = self.next if self.filled == self.length else 0
        picked = torch.randint((self.filled - self.horizon + 1) * self.num_envs, (num,), device=self.device)
        step = torch.arange(self.horizon, device=self.device)[:, None]
        rows, envs = (oldest + picked // self.num_envs + step) % self.length, picked % self.num_envs
        storage = self.storage
        ended_before = storage["over"][rows[:-1], envs].cumsum(0) > 0
        valid = torch.cat([torch.ones_like(rows[:1]), ~ended_before]).float()
        first = storage["observation"][rows[0], envs][None]
        return StoredSequences(
            torch.cat([first, storage["next_observation"][rows, envs]]),
            storage["action"][rows, envs],
            storage["reward"][rows, envs],
            storage["terminated"][rows, envs],
            valid,
            envs,
        )

    def state(self) -> tuple[dict[str, Tensor], dict[str, int]]:
        """Returns what it holds, as tensors and numbers that :meth:`load` reads back."""
        tensors = {key: value[: self.filled].clone() for key, value in self.storage.items()}
        return tensors, {"next": self.next, "filled": self.filled}

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, int]) -> None:
        """Takes back what :meth:`state` returned.

        Raises:
            CheckpointError: if it is of a buffer of another size.
        """
        filled = numbers["filled"]
        for key, value in self.storage.items():
            saved = tensors[key]
            if saved.shape[1:] != value.shape[1:] or filled > self.length:
                raise CheckpointError(
                    f"The replay buffer of the checkpoint has steps of shape {tuple(saved.shape[1:])}, this "
                    f"run's {tuple(value.shape[1:])}. Resume with the same policy.num_envs and "
                    "policy.buffer_size, or begin a new run (resume=false)."
                )
            value[:filled] = saved.to(self.device)
        self.next, self.filled = numbers["next"], filled


def check_room(buffer: Any, buffer_size: int, first_steps: int, key: str) -> None:
    """Checks that a replay buffer ever holds the steps after which learning begins.

    Args:
        buffer: A :class:`ReplayBuffer`, or what has its interface.
        buffer_size: The setting that it was made by.
        first_steps: Steps after which learning begins.
        key: The setting that decides these.

    Raises:
        ConfigError: It does not: the agent would never learn.
    """
    if buffer.capacity < first_steps:
        least = math.ceil(first_steps / buffer.num_envs) * buffer.num_envs
        raise ConfigError(
            f"policy.buffer_size={buffer_size} holds {buffer.capacity} steps, and learning begins after "
            f"{first_steps}. Take policy.buffer_size={least} at least, or a smaller {key}."
        )
