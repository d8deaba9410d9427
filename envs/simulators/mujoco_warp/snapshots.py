"""Snapshots of environments, kept on the device until they are rendered."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload, override

import numpy as np
import torch
from torch import Tensor

from envs.scenario import Appearance
from envs.simulators.mujoco.render import RenderJob


@dataclass(frozen=True, slots=True)
class Snapshots(Sequence[RenderJob]):
    """Snapshots of n environments for rendering; one of them is a :class:`RenderJob`.

    Attributes:
        qpos: Joint positions, (n, nq).
        mocap_pos: Positions of the bodies that are put in place, (n, nmocap, 3).
        mocap_quat: Their orientations, (n, nmocap, 4).
        appearances: How they look.
    """

    qpos: Tensor
    mocap_pos: Tensor
    mocap_quat: Tensor
    appearances: tuple[Appearance, ...]

    @override
    def __len__(self) -> int:
        return len(self.appearances)

    @overload
    def __getitem__(self, index: int) -> RenderJob: ...

    @overload
    def __getitem__(self, index: slice) -> "Snapshots": ...

    @override
    def __getitem__(self, index: int | slice) -> "RenderJob | Snapshots":
        qpos, pos, quat = self.qpos[index], self.mocap_pos[index], self.mocap_quat[index]
        if isinstance(index, slice):
            return Snapshots(qpos, pos, quat, self.appearances[index])
        arrays = [part.cpu().double().numpy() for part in (qpos, pos, quat)]
        return RenderJob(arrays[0], arrays[1], arrays[2], self.appearances[index])

    @classmethod
    def of(cls, jobs: Sequence[RenderJob], device: torch.device) -> "Snapshots":
        """Puts jobs on the device; snapshots stay as they are."""
        if isinstance(jobs, Snapshots):
            return jobs

        def stacked(arrays: list[np.ndarray]) -> Tensor:
            return torch.from_numpy(np.stack(arrays)).to(device=device, dtype=torch.float32)

        return cls(
            stacked([job.qpos for job in jobs]),
            stacked([job.mocap_pos for job in jobs]),
            stacked([job.mocap_quat for job in jobs]),
            tuple(job.appearance for job in jobs),
        )
