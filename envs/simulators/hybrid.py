"""Combines the physics of one simulator with the renderer of another.

After MetaSim's hybrid simulation (RoboVerse, arXiv:2504.18904, section 3): physics gives every state;
before rendering, states and appearances are copied into the rendering simulator.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import overload, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import SimulatorError, unknown_name
from envs.scenario import Appearance, ScenarioCfg
from envs.simulators import HANDLERS, RENDERERS
from envs.simulators.base import EnvIds, Handler, TextureSource, rows_of
from envs.state import State

MAX_DRAWN_AT_ONCE = 64
"""Environments of the rendering simulator; more images are rendered in batches of this size."""

OF_MODELS = "mujoco"
"""The simulator behind the renderers of :data:`~envs.simulators.RENDERERS`, when physics is another's."""


def make_handler(
    simulator: str,
    scenario: ScenarioCfg,
    num_envs: int,
    *,
    renderer: str,
    num_threads: int = 0,
    textures: TextureSource | None = None,
) -> Handler:
    """Makes the handler of a pair, without launching it: the simulator alone where it renders itself.

    Args:
        simulator: Registered simulator: physics.
        scenario: The scene.
        num_envs: Number of environments.
        renderer: Registered renderer, or a registered simulator that renders.
        num_threads: Threads that step and draw; 0 means one per core.
        textures: Gives the images of the named materials.

    Raises:
        UnknownNameError: if there is no such simulator or renderer.
        MissingExtraError: if a package that one of them needs is not installed.
    """
    given = {"num_threads": num_threads, "textures": textures}
    drawing, name = drawing_simulator(simulator, renderer)
    if drawing == simulator:
        return _construct(simulator, scenario, num_envs, name, given)
    return HybridHandler(scenario, num_envs, simulator=simulator, renderer=renderer, **given)


def drawing_simulator(simulator: str, renderer: str) -> tuple[str, str | None]:
    """Returns the simulator that renders, and which of its renderers, None for its only one.

    Raises:
        UnknownNameError: if there is no such simulator or renderer.
        MissingExtraError: if the simulator is not installed.
    """
    own = HANDLERS.get(simulator).own_renderers
    if renderer in own:
        return simulator, renderer
    if renderer in RENDERERS:
        return OF_MODELS, renderer
    if renderer not in HANDLERS:
        raise unknown_name(
            "renderer",
            renderer,
            {*RENDERERS, *HANDLERS},
            f"A simulator's name renders the states of {simulator} with that simulator.",
        )
    return renderer, next(iter(HANDLERS.get(renderer).own_renderers), None)


def _construct(
    simulator: str, scenario: ScenarioCfg, num_envs: int, renderer: str | None, given: Mapping
) -> Handler:
    chosen = {} if renderer is None else {"renderer": renderer}
    return HANDLERS.get(simulator)(scenario, num_envs, **chosen, **given)


@dataclass(frozen=True, slots=True)
class StateSnapshots(Sequence["StateSnapshots"]):
    """StateSnapshots of some environments, to be rendered later; an item is one of them.

    Attributes:
        states: Their states, (n, …).
        appearances: How they look.
    """

    states: State
    appearances: tuple[Appearance, ...]

    @override
    def __len__(self) -> int:
        return len(self.appearances)

    @overload
    def __getitem__(self, index: int) -> "StateSnapshots": ...

    @overload
    def __getitem__(self, index: slice) -> "StateSnapshots": ...

    @override
    def __getitem__(self, index: int | slice) -> "StateSnapshots":
        rows = range(len(self))[index if isinstance(index, slice) else slice(index, index + 1 or None)]
        if not isinstance(index, slice) and not rows:
            raise IndexError(f"There are {len(self)} snapshots, and none at {index}.")
        return StateSnapshots(self.states.select(list(rows)), tuple(self.appearances[row] for row in rows))

    @classmethod
    def of(cls, jobs: Sequence["StateSnapshots"]) -> "StateSnapshots":
        """Joins jobs; snapshots stay as they are."""
        if isinstance(jobs, StateSnapshots):
            return jobs
        flats = [job.states.flatten() for job in jobs]
        states = State.unflatten({key: torch.cat([flat[key] for flat in flats]) for key in flats[0]})
        return cls(states, tuple(look for job in jobs for look in job.appearances))


class HybridHandler(Handler):
    """A simulator that is rendered with another one.

    The rendering simulator is launched at the first image; it never steps.

    Args:
        scenario: The scene.
        num_envs: Number of environments.
        simulator: Registered simulator: physics.
        renderer: Registered simulator that renders, or one of the renderers of MuJoCo's models.
        num_threads: Threads that step and draw; 0 means one per core.
        textures: Gives the images of the named materials.

    Attributes:
        physics: Where states come from.
        drawing: Rendering simulator.
    """

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        simulator: str = "mujoco",
        renderer: str = "mujoco_warp",
        num_threads: int = 0,
        textures: TextureSource | None = None,
    ) -> None:
        super().__init__(scenario, num_envs, renderer=renderer, num_threads=num_threads, textures=textures)
        given = {"num_threads": num_threads, "textures": textures}
        drawing, name = drawing_simulator(simulator, renderer)
        self.physics: Handler = HANDLERS.get(simulator)(scenario, num_envs, **given)
        at_once = min(num_envs, MAX_DRAWN_AT_ONCE)
        self.drawing: Handler = _construct(drawing, scenario, at_once, name, given)
        self.dtype, self.steps_together = self.physics.dtype, self.physics.steps_together
        self._appearances = [scenario.appearance] * num_envs
        self._draws = self._closed = False

    @override
    def launch(self) -> None:
        self.physics.launch()
        self.device = self.physics.device

    # -- physics ------------------------------------------------------------------------------------

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        return self.physics.get_states(env_ids)

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        self.physics.set_states(states, env_ids)

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        self.physics.set_poses(poses, env_ids)

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        self.physics.set_joint_targets(targets, env_ids)

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        self.physics.step(num_steps, env_ids)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self.physics.step_towards(targets, num_steps, env_ids)

    # -- images -----------------------------------------------------------------------------------

    @override
    def set_appearance(self, appearance: Appearance, env_id: int) -> None:
        self._appearances[env_id] = appearance

    @override
    def snapshot(self, env_ids: EnvIds = None) -> StateSnapshots:
        ids = rows_of(env_ids, self.num_envs).tolist()
        return StateSnapshots(self.physics.get_states(env_ids), tuple(self._appearances[i] for i in ids))

    @override
    def render_jobs(
        self,
        jobs: Sequence[StateSnapshots],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        names, modalities = self.checked_names(cameras, modalities)
        count, at_once = len(jobs), self.drawing.num_envs
        if not count:
            jobs = self.snapshot([0])  # for the shapes of what is not there
        portions = [
            self._draw(StateSnapshots.of(jobs[start : start + at_once]), names, modalities)
            for start in range(0, len(jobs), at_once)
        ]
        return {
            camera: {
                kind: np.concatenate([part[camera][kind] for part in portions])[:count] for kind in modalities
            }
            for camera in names
        }

    def _draw(
        self, snapshots: StateSnapshots, cameras: Sequence[str], modalities: Sequence[str]
    ) -> dict[str, dict[str, np.ndarray]]:
        drawing, rows = self._drawing, list(range(len(snapshots)))
        drawing.set_states(snapshots.states.to(drawing.device, drawing.dtype), rows)
        for row, appearance in enumerate(snapshots.appearances):
            drawing.set_appearance(appearance, row)
        return drawing.render(cameras, modalities, rows)

    @property
    def _drawing(self) -> Handler:
        """The rendering simulator, launched at the first image."""
        if self._closed:
            raise SimulatorError("The simulator is closed: nothing can be rendered after close().")
        if not self._draws:
            self.drawing.launch()
            self._draws = True
        return self.drawing

    @property
    @override
    def segmentation_names(self) -> tuple[str, ...]:
        return self._drawing.segmentation_names

    @property
    @override
    def not_shown(self) -> tuple[str, ...]:
        return self.drawing.not_shown

    @override
    def close(self) -> None:
        self._closed = True
        self.physics.close()
        if self._draws:
            self.drawing.close()
            self._draws = False
