"""The interface of a simulator: states, joint targets, steps and images."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Any, ClassVar, Self, TypedDict

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import unknown_name
from envs.scenario import Appearance, ScenarioCfg
from envs.state import State

EnvIds = Sequence[int] | np.ndarray | Tensor | None
"""Sorted, unique environment indices, on any device; None means all."""

TextureSource = Callable[[str, int], np.ndarray]
"""``textures(name, size)`` returns the image (size, size, 3) uint8 of a material."""

MODALITIES = ("rgb", "depth", "segmentation")


def index_of(env_ids: EnvIds) -> slice | np.ndarray:
    """Returns what selects the rows of these environments in a NumPy array."""
    if env_ids is None:
        return slice(None)
    return env_ids.cpu().numpy() if isinstance(env_ids, Tensor) else np.asarray(env_ids)


def rows_of(env_ids: EnvIds, num_envs: int) -> np.ndarray:
    """Returns the indices of these environments of ``num_envs``, (n,) int64."""
    return np.arange(num_envs)[index_of(env_ids)]


class HandlerOptions(TypedDict, total=False):
    """Keyword arguments of every simulator; see :class:`Handler`."""

    renderer: str
    num_threads: int
    textures: TextureSource | None


class Handler(ABC):
    """One simulator with ``num_envs`` copies of one scenario.

    Attributes:
        scenario: The scene.
        num_envs: Number of environments.
        renderer_name: Name of the renderer.
        num_threads: Threads that step and render; 0 means one per core.
        textures: Images of the named materials, or None for plain colours.
        dtype: Precision of its states. A state that is set is rounded to it, and reads bit-identical.
        device: Where its states are.
        steps_together: Whether stepping all environments costs no more than stepping some.
        own_renderers: Its own renderers, the default first, where it has more than the one that has its
            name; any other renderer is combined with it by :mod:`envs.simulators.hybrid`.
    """

    own_renderers: ClassVar[tuple[str, ...]] = ()
    steps_together: bool = False
    dtype: torch.dtype = torch.float64
    device: torch.device = torch.device("cpu")

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        renderer: str = "warp",
        num_threads: int = 0,
        textures: TextureSource | None = None,
    ) -> None:
        self.scenario = scenario
        self.num_envs = num_envs
        self.renderer_name = renderer
        self.num_threads = num_threads
        self.textures = textures

    @abstractmethod
    def launch(self) -> None:
        """Builds the scene. Call it once, before anything else."""

    @abstractmethod
    def get_states(self, env_ids: EnvIds = None) -> State:
        """Returns the present state of the environments ``env_ids``, in copies."""

    @abstractmethod
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        """Puts the environments ``env_ids`` into ``states`` (one row each) and resets warm-start state.

        Entities that ``states`` does not name keep their state.
        """

    @abstractmethod
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        """Moves fixed objects and markers, without a reset: for objects that move during an episode.

        Args:
            poses: Name to position (n, 3), m, and orientation (n, 4), wxyz.
            env_ids: Environments.
        """

    def get_joint_targets(self, robot: str, env_ids: EnvIds = None) -> Tensor:
        """Returns the present position targets (n, J) of a robot's driven joints, in a copy."""
        targets = self.get_states(env_ids).robots[robot].joint_target
        assert targets is not None, "a simulator gives every robot's targets"
        return targets

    def get_joint_positions(self, robot: str, env_ids: EnvIds = None) -> Tensor:
        """Returns the present positions (n, Q) of all joints of a robot, in a copy."""
        return self.get_states(env_ids).robots[robot].joint_pos

    @abstractmethod
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        """Sets the position targets (n, J) of the named robots, clipped to the joints' ranges."""

    @abstractmethod
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        """Advances the environments ``env_ids`` by ``num_steps`` physics steps.

        Raises:
            SimulatorError: if an environment's state is no longer finite; it names the environments. A
                simulator whose environments cannot be stopped alone restarts and counts them instead.
        """

    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        """Advances by ``num_steps`` physics steps while the targets of joints move evenly to ``targets``.

        Targets are interpolated linearly and arrive in the last step. So an arm moves without the jerk of a
        jump, which shakes a grasped object.

        Args:
            targets: Robot to position targets (n, J); see :meth:`set_joint_targets`.
            num_steps: Physics steps.
            env_ids: Environments.
        """
        states = self.get_states(env_ids)
        for index in range(1, num_steps + 1):
            moved = {}
            for name, target in targets.items():
                start = states.robots[name].joint_target
                assert start is not None, "a simulator gives every robot's targets"
                end = torch.as_tensor(target, dtype=start.dtype, device=start.device)
                moved[name] = torch.lerp(start, end, index / num_steps)
            self.set_joint_targets(moved, env_ids)
            self.step(1, env_ids)

    @abstractmethod
    def set_appearance(self, appearance: Appearance, env_id: int) -> None:
        """Sets the appearance of the environment ``env_id``; the noise of its sensor begins anew.

        Within an episode, :meth:`change_look` sets another look.
        """

    def change_look(self, appearance: Appearance, env_id: int) -> None:
        """Sets the materials, lights and camera poses of the environment ``env_id`` within an episode.

        A handler with sensor noise overrides it, so that an episode keeps its own.
        """
        self.set_appearance(appearance, env_id)

    def render(
        self,
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
        env_ids: EnvIds = None,
    ) -> dict[str, dict[str, np.ndarray]]:
        """Renders the environments ``env_ids`` with the named cameras (None: all of them).

        Returns:
            Camera to modality to image: ``rgb`` (n, H, W, 3) uint8; ``depth`` (n, H, W) float32, metres
            along the optical axis, 0 where there is nothing; ``segmentation`` (n, H, W) int32, an index
            into :attr:`segmentation_names`, or -1.
        """
        return self.render_jobs(self.snapshot(env_ids), cameras, modalities)

    def checked_names(
        self, cameras: Sequence[str] | None, modalities: Sequence[str]
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Returns which cameras (None: all of them) and modalities are rendered.

        Raises:
            UnknownNameError: if the scenario has no such camera, or there is no such modality.
        """
        valid = [camera.name for camera in self.scenario.cameras]
        names = valid if cameras is None else list(cameras)
        for name in names:
            if name not in valid:
                raise unknown_name("camera", name, valid)
        for modality in modalities:
            if modality not in MODALITIES:
                raise unknown_name("modality", modality, MODALITIES)
        return tuple(names), tuple(modalities)

    @abstractmethod
    def snapshot(self, env_ids: EnvIds = None) -> Sequence[Any]:
        """Returns what :meth:`render_jobs` needs to render the present state of the environments later."""

    @abstractmethod
    def render_jobs(
        self,
        jobs: Sequence[Any],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        """Renders snapshots; see :meth:`render`."""

    def render_tensors(
        self,
        jobs: Sequence[Any] | None = None,
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, Tensor]]:
        """Renders snapshots, or every environment's present state, to images on :attr:`device`."""
        images = self.render_jobs(self.snapshot() if jobs is None else jobs, cameras, modalities)
        return {
            camera: {modality: torch.from_numpy(image).to(self.device) for modality, image in kinds.items()}
            for camera, kinds in images.items()
        }

    @property
    @abstractmethod
    def segmentation_names(self) -> tuple[str, ...]:
        """Names of the segmentation's classes: robots, objects and surfaces."""

    @property
    @abstractmethod
    def not_shown(self) -> tuple[str, ...]:
        """Properties of an appearance that this renderer cannot show."""

    @abstractmethod
    def close(self) -> None:
        """Frees everything. Calling it twice is harmless."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
