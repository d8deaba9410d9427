"""Replay buffer of images: every frame once, in bytes, on the device of training.

Shapes: L rows, N environments, F frames of an observation, C channels and P pixels of a frame, A action,
B samples, H steps of a sequence.
"""

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from envs.core.errors import CheckpointError, ConfigError
from roboverse_learn.training.rl.replay_buffer import StoredSequences, Transitions


class FrameReplay:
    """A ring of the last L rows of N environments, with the interface of a ``ReplayBuffer``.

    A row is the newest frame of an observation, with the action taken on it. An episode of T steps takes
    T + 1 rows: the last is its final frame, without an action. Frames are stacked when they are sampled:
    ``age``, the steps since the episode began, limits how far back a stack reaches.

    ::

        an episode of 2 steps, then the next one       frame   f0 f1 f2 | g0 g1 …
                                                       action  a0 a1  - | b0 b1 …
                                                       age      0  1  2 |  0  1 …

    Environments whose episodes ended more often are farther ahead in their rows, so each has its own pointer.

    Args:
        capacity: Steps that are kept, over all environments together, the rows of ends included.
        num_envs: N.
        frame_shape: (C, P, P).
        num_frames: F.
        action_size: A.
        device: Where it is kept.
        horizon: H.

    Raises:
        ConfigError: if it is too small for a sequence, or too large for the device.
    """

    def __init__(
        self,
        capacity: int,
        num_envs: int,
        frame_shape: tuple[int, int, int],
        num_frames: int,
        action_size: int,
        device: torch.device,
        horizon: int,
    ) -> None:
        self.length = capacity // num_envs  # L
        least = horizon + num_frames + 1
        if self.length < least:
            raise ConfigError(
                f"policy.buffer_size={capacity} holds {self.length} row(s) of each of {num_envs} "
                f"environments. Take {num_envs * least} at least, or a smaller policy.num_envs."
            )
        self.num_envs, self.num_frames, self.horizon, self.device = num_envs, num_frames, horizon, device
        self.added = 0  # steps of each environment
        shape = (self.length, num_envs)
        self.storage = {
            "frame": _bytes((*shape, *frame_shape), device, capacity),
            "action": torch.zeros(*shape, action_size, device=device),
            "reward": torch.zeros(shape, device=device),
            "terminated": torch.zeros(shape, device=device),
            "end": torch.zeros(shape, dtype=torch.bool, device=device),
            "age": torch.zeros(shape, dtype=torch.int32, device=device),
        }
        self.present = {
            "next": torch.zeros(num_envs, dtype=torch.int64, device=device),  # row that is written next
            "filled": torch.zeros(num_envs, dtype=torch.int64, device=device),  # rows before it that count
            "now": torch.zeros(num_envs, dtype=torch.int32, device=device),  # age of the next row
        }
        self._envs = torch.arange(num_envs, device=device)

    def __len__(self) -> int:
        return min(self.added, self.length) * self.num_envs

    @property
    def capacity(self) -> int:
        """Steps of all environments that fit."""
        return self.length * self.num_envs

    def add(self, transitions: Transitions, over: Tensor) -> None:
        """Adds one step of every environment.

        Args:
            transitions: The step, B = N; observations are stacks (N, F C, P, P) uint8.
            over: Whether the episode is over, whatever ended it, (N,) bool.
        """
        storage, envs = self.storage, self._envs
        row, now = self.present["next"], self.present["now"]
        after, channels = (row + 1) % self.length, storage["frame"].shape[2]
        storage["frame"][row, envs] = transitions.observation[:, -channels:]
        for key in ("action", "reward", "terminated"):
            storage[key][row, envs] = getattr(transitions, key)
        storage["age"][row, envs], storage["end"][row, envs] = now, False
        # What is seen after the step ends the episode, unless the next step says otherwise.
        storage["frame"][after, envs] = transitions.next_observation[:, -channels:]
        storage["age"][after, envs], storage["end"][after, envs] = now + 1, True
        taken = 1 + over.long()
        oldest_stack = self.length - self.num_frames  # the frames before the oldest row that counts stay
        self.present = {
            "next": (row + taken) % self.length,
            "filled": (self.present["filled"] + taken).clamp(max=oldest_stack),
            "now": torch.where(over, 0, now + 1),
        }
        self.added += 1

    def sequences(self, num: int) -> StoredSequences:
        """Returns ``num`` sequences of H steps, sampled uniformly from environments and their rows.

        Observations are (H + 1, B, F C, P, P) uint8. Steps after the episode's end are marked as not
        valid; so is all of a sequence that begins at an end, one of each episode's length.
        """
        storage, device = self.storage, self.device
        envs = torch.randint(self.num_envs, (num,), device=device)
        filled = self.present["filled"][envs]
        first = (torch.rand(num, device=device) * (filled - self.horizon + 1)).long()
        start = self.present["next"][envs] - filled + first
        rows = (start + torch.arange(self.horizon + 1, device=device)[:, None]) % self.length  # (H + 1, B)
        steps = rows[:-1]
        return StoredSequences(
            self._stacks(rows, envs),
            storage["action"][steps, envs],
            storage["reward"][steps, envs],
            storage["terminated"][steps, envs],
            (storage["end"][steps, envs].cumsum(0) == 0).float(),
            envs,
        )

    def _stacks(self, rows: Tensor, envs: Tensor) -> Tensor:
        """Returns the observations (H + 1, B, F C, P, P) of rows (H + 1, B) of environments (B,)."""
        back = torch.arange(self.num_frames - 1, -1, -1, device=self.device)  # the oldest first
        age = self.storage["age"][rows, envs].long()
        of_stack = (rows[..., None] - torch.minimum(back, age[..., None])) % self.length  # (H + 1, B, F)
        return self.storage["frame"][of_stack, envs[:, None]].flatten(2, 3)

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Returns what it holds, as tensors and numbers that :meth:`load` reads back."""
        filled = int(self.present["filled"].max())
        written = filled + 1 if filled < self.length - self.num_frames else self.length  # never gone around
        tensors = {key: value[:written].clone() for key, value in self.storage.items()}
        return tensors | {key: value.clone() for key, value in self.present.items()}, {"added": self.added}

    def load(self, tensors: Mapping[str, Tensor], numbers: Mapping[str, Any]) -> None:
        """Takes back what :meth:`state` returned.

        Raises:
            CheckpointError: if it is of a buffer of another size.
        """
        for key, value in self.storage.items():
            saved = tensors[key]
            if saved.shape[1:] != value.shape[1:] or len(saved) > self.length:
                raise CheckpointError(
                    f"The replay buffer of the checkpoint has {len(saved)} rows of shape "
                    f"{tuple(saved.shape[1:])}, this run's {self.length} of {tuple(value.shape[1:])}. Resume "
                    "with the same policy.num_envs, policy.buffer_size and cameras, or begin a new run "
                    "(resume=false)."
                )
            value[: len(saved)] = saved.to(self.device)
        self.present = {key: tensors[key].to(self.device, copy=True) for key in self.present}
        self.added = numbers["added"]


def _bytes(shape: tuple[int, ...], device: torch.device, capacity: int) -> Tensor:
    """Returns zeros of a shape, uint8.

    Raises:
        ConfigError: if there is no room for them.
    """
    try:
        return torch.zeros(shape, dtype=torch.uint8, device=device)
    except RuntimeError as error:  # of which torch.OutOfMemoryError is one
        size = torch.Size(shape).numel()
        raise ConfigError(
            f"policy.buffer_size={capacity} takes {size / 1e9:.1f} GB of images, for which there is no "
            f"room on '{device}'. Take a smaller one: a step takes {size / capacity / 1e3:.0f} kB."
        ) from error
