"""A dataset in memory with the interface of the resident one: the action is where the bright square is."""

from types import SimpleNamespace

import numpy as np
import torch

from roboverse_learn.data.dataset.frame_table import clamp_window
from tests.policies.examples import FEATURES, IMAGE, SIZE

EPISODE_LENGTH = 10


class SquareFrames:
    features = FEATURES

    def __init__(self, num_episodes: int = 4) -> None:
        rng = np.random.default_rng(0)
        n = num_episodes * EPISODE_LENGTH
        corners = rng.integers(0, SIZE - 8, (n, 2))
        images = rng.integers(80, 120, (n, 3, SIZE, SIZE))
        for image, (row, column) in zip(images, corners, strict=True):
            image[:, row : row + 8, column : column + 8] = 250
        actions = rng.normal(scale=0.1, size=(n, 9))
        actions[:, :2] += corners / SIZE
        self.frames = {
            IMAGE: torch.from_numpy(images.astype(np.uint8)),
            "observation.state": torch.from_numpy(rng.normal(size=(n, 9)).astype(np.float32)),
            "action": torch.from_numpy(actions.astype(np.float32)),
            "task_index": torch.zeros(n, dtype=torch.int64),
        }
        starts = np.arange(num_episodes) * EPISODE_LENGTH
        self.info = SimpleNamespace(
            num_episodes=num_episodes,
            num_frames=n,
            episode_starts=starts,
            episode_ends=starts + EPISODE_LENGTH,
        )
        self._starts = np.repeat(starts, EPISODE_LENGTH)

    @property
    def stats(self) -> dict:
        image = {name: torch.full((3, 1, 1), value) for name, value in
                 {"mean": 0.4, "std": 0.2, "min": 0.0, "max": 1.0}.items()}  # fmt: skip
        vectors = {
            key: {"mean": x.mean(0), "std": x.std(0), "min": x.amin(0), "max": x.amax(0)}
            for key, x in self.frames.items() if key not in (IMAGE, "task_index")
        }  # fmt: skip
        return vectors | {IMAGE: image}

    def sample(self, indices, delta_indices, *, keys) -> dict[str, torch.Tensor]:
        index = np.asarray(indices)
        starts = self._starts[index]
        batch = {}
        for key in keys:
            if key in delta_indices:
                rows, is_pad = clamp_window(index, delta_indices[key], starts, starts + EPISODE_LENGTH)
                batch |= {key: self.frames[key][rows], f"{key}_is_pad": torch.from_numpy(is_pad)}
            else:
                batch[key] = self.frames[key][index]
        return batch
