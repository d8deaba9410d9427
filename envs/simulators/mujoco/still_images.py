"""Images of what does not move, for the ray tracer on a CPU.

While a scene looks the same, most pixels of a fixed camera do: only those that moving geoms cover or shade
can change. So the scene is traced once without what moves, and each image takes from there the pixels that
:mod:`~envs.simulators.mujoco.moving_parts` calls certainly untouched. The others are traced in the whole
scene. Images are bit-identical: a ray that meets no moving geom finds the same with and without them.

Shapes: G visible geoms, P pixels of all cameras, one camera after the other.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from envs.scenario import Appearance
from envs.simulators.mujoco.moving_parts import Boxes, CameraPlane, LightPlane, can_move

KEPT_PIXELS = 2**21
"""Pixels of the looks that a tracer keeps, 12 bytes each in the main: 64 looks in two images of 128×128."""

LEAST_UNTOUCHED = 0.3
"""Share of the fixed cameras' pixels below which still images save nothing: boxes and copies take as long."""

_FIXED = int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)
_DISTANT = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
_UNBOUNDED = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))

Images = Mapping[str, np.ndarray]
"""By kind, a value for each pixel, (1, P, …)."""


@dataclass(slots=True)
class Still:
    """A look and, once it was traced, what it shows without what moves.

    Attributes:
        appearance: The look.
        poses: Where the geoms were, (G, 12).
        view: Where fixed cameras and lights are.
        images: What was traced; empty before, and where it would be no gain.
        cameras: Planes of the cameras; of one without, all pixels are traced.
        lights: Planes of the lights that cast shadows.
        no_gain: Too few pixels are untouched.
    """

    appearance: Appearance
    poses: np.ndarray
    view: np.ndarray
    images: Images
    cameras: Sequence[CameraPlane | None] = ()
    lights: Sequence[LightPlane] = ()
    no_gain: bool = False


class StillImages:
    """The still images of a render context.

    A geom moves if it was seen in two places under one look; then so does all that may move with it.

    Args:
        model: The model.
        geoms: Ids of its visible geoms, (G,).
        cameras: Ids of the cameras.
        rays: Their rays (H, W, 3), each in its camera's frame.
        kinds: Kinds of images to keep.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        geoms: np.ndarray,
        cameras: Sequence[int],
        rays: Sequence[np.ndarray],
        kinds: Sequence[str],
    ) -> None:
        self._model, self._geoms, self._cameras = model, geoms, np.asarray(cameras)
        self._rays, self._kinds = list(rays), tuple(kinds)
        movable = can_move(model)
        bodies = model.geom_bodyid[geoms]
        self._trees = np.where(movable[bodies], model.body_rootid[bodies], -1)
        self._moving = np.zeros(len(geoms), bool)
        self._boxes = Boxes(model, geoms[self._moving])
        self._is_fixed = ~movable[model.cam_bodyid[self._cameras]]
        self._is_fixed &= model.cam_mode[self._cameras] == _FIXED
        self._usable = bool(
            self._is_fixed.any()
            and not movable[model.light_bodyid].any()
            and (model.light_mode == _FIXED).all()
            and not model.nflex
            and not model.cam_projection[self._cameras].any()
        )
        sizes = np.array([one.shape[0] * one.shape[1] for one in self._rays])
        self._num_fixed = sizes[self._is_fixed].sum()
        self._known: dict[int, Still] = {}
        self._capacity = max(KEPT_PIXELS // int(sizes.sum()), 2)

    @property
    def moving(self) -> np.ndarray:
        """Which geoms move, (G,) bool."""
        return self._moving

    def of(self, appearance: Appearance, data: mujoco.MjData, trace: Callable[[], Images]) -> Still | None:
        """Returns the still image of a look, or None where it is no gain, as where the look is new.

        Args:
            appearance: The look.
            data: The scene with this look.
            trace: Traces it without what moves, depth included.
        """
        if not self._usable:
            return None
        poses, view = self._poses(data), self._view(data)
        still = self._known.pop(id(appearance), None)
        is_new = still is None or not np.array_equal(still.view, view)
        if still is None or is_new:
            still = Still(appearance, poses, view, {})
        self._known[id(appearance)] = still  # the last of the order
        if len(self._known) > self._capacity:
            del self._known[next(iter(self._known))]
        self._note_moved((poses != still.poses).any(axis=1))
        if is_new or still.no_gain or not self._usable:
            return None
        if not still.images:
            self._complete(still, data, trace())
        return None if still.no_gain else still

    def touched(self, still: Still, data: mujoco.MjData) -> np.ndarray:
        """Returns which pixels may show or lie in the shadow of what moves, ascending."""
        corners = self._boxes.corners(data)
        parts = [
            np.ones(rays.shape[0] * rays.shape[1], bool) if plane is None else plane.touched(corners).ravel()
            for plane, rays in zip(still.cameras, self._rays, strict=True)
        ]
        mask = np.concatenate(parts)
        for light in still.lights:
            mask |= light.touched(corners)
        return np.flatnonzero(mask)

    def _note_moved(self, moved: np.ndarray) -> None:
        """Adds geoms (G,) to those that move, with all of their trees; still images must be traced again."""
        if not (moved & ~self._moving).any():
            return
        trees = np.unique(self._trees[moved])
        self._moving |= moved | (np.isin(self._trees, trees) & (self._trees >= 0))
        moving = self._geoms[self._moving]
        self._usable = not np.isin(self._model.geom_type[moving], _UNBOUNDED).any()
        self._boxes = Boxes(self._model, moving)
        for still in self._known.values():
            still.images, still.no_gain = {}, False

    def _poses(self, data: mujoco.MjData) -> np.ndarray:
        return np.concatenate([data.geom_xpos[self._geoms], data.geom_xmat[self._geoms]], axis=1)

    def _view(self, data: mujoco.MjData) -> np.ndarray:
        fixed = self._cameras[self._is_fixed]
        every = (data.cam_xpos[fixed], data.cam_xmat[fixed], data.light_xpos, data.light_xdir)
        return np.concatenate([one.ravel() for one in every])

    def _complete(self, still: Still, data: mujoco.MjData, images: Images) -> None:
        """Adds what was traced without what moves."""
        planes, points, shown, start = [], [], [], 0
        for camera, is_fixed, rays in zip(self._cameras, self._is_fixed, self._rays, strict=True):
            count = rays.shape[0] * rays.shape[1]
            depth = images["depth"][0, start : start + count].astype(np.float64)
            pos, axes = data.cam_xpos[camera].copy(), data.cam_xmat[camera].reshape(3, 3).copy()
            local = rays.reshape(-1, 3).astype(np.float64)
            points.append(pos + (local * (depth / -local[:, 2])[:, None]) @ axes.T)
            planes.append(CameraPlane.of(pos, axes, rays) if is_fixed else None)
            shown.append((depth > 0.0) & (planes[-1] is not None))
            start += count
        model = self._model
        casting = np.flatnonzero((model.light_active != 0) & (model.light_castshadow != 0))
        every = np.concatenate(points), np.concatenate(shown)
        still.lights = [LightPlane.of(data.light_xdir[light].copy(), *every) for light in casting]
        still.cameras = planes
        still.no_gain = (
            bool((model.light_type[casting] != _DISTANT).any())
            or start - len(self.touched(still, data)) < LEAST_UNTOUCHED * self._num_fixed
        )
        still.images = {kind: images[kind].copy() for kind in self._kinds}
