"""A simulator whose images are disturbed after they are rendered, as the appearances of its environments say.

Everything that renders asks a handler, so an image is disturbed once, wherever it goes: to an observation
that is rendered late, a dataset, an evaluation, a video. Where neither a channel nor the scene disturbs
images there is no such handler.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload, override

import numpy as np
from torch import Tensor

from envs.randomization.disturbances import disturb, disturb_arrays
from envs.scenario import Appearance, SensorCfg
from envs.simulators.base import EnvIds, Handler, index_of, rows_of
from envs.state import State


@dataclass(frozen=True, slots=True)
class Exposures(Sequence["Exposures"]):
    """Snapshots, and what the cameras do to their images; an item is one of them.

    Attributes:
        jobs: Snapshots of the simulator, n.
        sensors: What is done to the images of each.
        frames: Number of each in its episode.
    """

    jobs: Sequence[Any]
    sensors: tuple[SensorCfg, ...]
    frames: tuple[int, ...]

    @override
    def __len__(self) -> int:
        return len(self.frames)

    @overload
    def __getitem__(self, index: int) -> "Exposures": ...

    @overload
    def __getitem__(self, index: slice) -> "Exposures": ...

    @override
    def __getitem__(self, index: int | slice) -> "Exposures":
        if isinstance(index, slice):
            return Exposures(self.jobs[index], self.sensors[index], self.frames[index])
        return Exposures([self.jobs[index]], (self.sensors[index],), (self.frames[index],))


class DisturbedHandler(Handler):
    """A handler around another one.

    An episode's frames are counted in physics steps from when the environment got its appearance, which
    begins an episode; a state that is set later, as in a replay of recorded states, is a control step later.

    Args:
        handler: The simulator, not yet launched.

    Attributes:
        handler: See above.
    """

    def __init__(self, handler: Handler) -> None:
        super().__init__(
            handler.scenario,
            handler.num_envs,
            renderer=handler.renderer_name,
            num_threads=handler.num_threads,
            textures=handler.textures,
        )
        self.handler = handler
        self.dtype, self.steps_together = handler.dtype, handler.steps_together
        self._sensors: list[SensorCfg] = [handler.scenario.appearance.sensor] * handler.num_envs
        self._steps = np.zeros(handler.num_envs, np.int64)

    def __getattr__(self, name: str) -> Any:
        if name == "handler":  # asked for by a copy that is not yet complete
            raise AttributeError(name)
        return getattr(self.handler, name)

    @override
    def launch(self) -> None:
        self.handler.launch()
        self.device = self.handler.device

    # -- physics ------------------------------------------------------------------------------------

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        return self.handler.get_states(env_ids)

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        self.handler.set_states(states, env_ids)
        self._pass(self.scenario.physics.decimation, env_ids)

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        self.handler.set_poses(poses, env_ids)

    @override
    def get_joint_targets(self, robot: str, env_ids: EnvIds = None) -> Tensor:
        return self.handler.get_joint_targets(robot, env_ids)

    @override
    def get_joint_positions(self, robot: str, env_ids: EnvIds = None) -> Tensor:
        return self.handler.get_joint_positions(robot, env_ids)

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        self.handler.set_joint_targets(targets, env_ids)

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        self.handler.step(num_steps, env_ids)
        self._pass(num_steps, env_ids)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self.handler.step_towards(targets, num_steps, env_ids)
        self._pass(num_steps, env_ids)

    def _pass(self, num_steps: int, env_ids: EnvIds) -> None:
        self._steps[index_of(env_ids)] += num_steps

    # -- images -------------------------------------------------------------------------------------

    @override
    def set_appearance(self, appearance: Appearance, env_id: int) -> None:
        self.handler.set_appearance(appearance, env_id)
        self._sensors[env_id], self._steps[env_id] = appearance.sensor, 0

    @override
    def change_look(self, appearance: Appearance, env_id: int) -> None:
        self.handler.change_look(appearance, env_id)  # the sensor stays the episode's own

    @override
    def snapshot(self, env_ids: EnvIds = None) -> Exposures:
        ids = rows_of(env_ids, self.num_envs).tolist()
        frames = tuple(int(self._steps[env_id]) for env_id in ids)
        return Exposures(self.handler.snapshot(env_ids), tuple(self._sensors[i] for i in ids), frames)

    @override
    def render_jobs(
        self,
        jobs: Sequence[Exposures],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        shots = _joined(jobs)
        rendered = self.handler.render_jobs(shots.jobs, cameras, modalities)
        for camera, kinds in rendered.items():
            if "rgb" in kinds:
                kinds["rgb"] = disturb_arrays(kinds["rgb"], shots.sensors, shots.frames, camera)
        return rendered

    @override
    def render_tensors(
        self,
        jobs: Sequence[Exposures] | None = None,
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, Tensor]]:
        shots = self.snapshot() if jobs is None else _joined(jobs)
        rendered = self.handler.render_tensors(shots.jobs if jobs is not None else None, cameras, modalities)
        for camera, kinds in rendered.items():
            if "rgb" in kinds:
                kinds["rgb"] = disturb(kinds["rgb"], shots.sensors, shots.frames, camera)
        return rendered

    @property
    @override
    def segmentation_names(self) -> tuple[str, ...]:
        return self.handler.segmentation_names

    @property
    @override
    def not_shown(self) -> tuple[str, ...]:
        return self.handler.not_shown

    @override
    def close(self) -> None:
        self.handler.close()


def _joined(jobs: Sequence[Exposures]) -> Exposures:
    """Joins jobs that were taken one by one; others stay as they are."""
    if isinstance(jobs, Exposures):
        return jobs
    return Exposures(
        [each for job in jobs for each in job.jobs],
        tuple(sensor for job in jobs for sensor in job.sensors),
        tuple(frame for job in jobs for frame in job.frames),
    )
