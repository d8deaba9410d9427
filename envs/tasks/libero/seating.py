"""Puts the objects of LIBERO's initial states down where they stand.

Its states are from before anything has settled: objects hang up to 18 cm over their places, and some are
inside the table. Dropped from there some tip over or roll away. Instead they are seated, lowest first: each
is raised until it overlaps nothing, lowered until it touches, and all of them settle together. The result is
kept in the cache, under a name that follows from every file that it depends on.
"""

import hashlib
import json
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import torch

from envs.core.assets import cache_dir
from envs.core.atomic import atomic_path
from envs.mjcf.layout import Layout, layout_of
from envs.mjcf.model import build_models
from envs.state import State
from envs.tasks.libero.catalogue import Entry
from envs.tasks.libero.files import problem_file, start_file
from envs.tasks.libero.scene import LiberoScene
from envs.tasks.libero.start_files import fixed_starts
from envs.tasks.skills.clouds import cloud

SETTLE_S = 0.6
"""Time in which all objects come to rest together."""

RAISE_STEP_M, LOWER_STEP_M, TOUCH_M = 0.002, 0.005, 0.0002
"""Steps of raising and of lowering, and how exactly the first touch is found."""

MOST_RAISED_M, MOST_LOWERED_M = 0.3, 0.4

_AWAY_M = 5.0
_VERSION = 4


@dataclass(frozen=True, slots=True)
class Seat:
    """How well seating went in one state.

    Attributes:
        moved_m: Largest level distance of a seated object from where its file has it.
        tilt_rad: Largest angle between an object's seated vertical axis and the file's.
        speed_m_s: Largest speed that is left.
    """

    moved_m: float
    tilt_rad: float
    speed_m_s: float


def seated_starts(entry: Entry, scene: LiberoScene) -> State:
    """Returns the 50 states with every object where it stands, (50 rows), from the cache if it has them."""
    starts = fixed_starts(entry, scene)
    path = cache_dir("starts") / f"{_name(entry, scene)}.npz"
    names = list(scene.problem.objects)
    poses = _stored(path, (starts.num_envs, len(names), 7))
    if poses is None:
        poses = Seater(scene).poses(starts)
        with atomic_path(path, keep_suffix=True) as partial:
            np.savez(partial, poses=poses)
    return with_poses(scene, starts, poses)


def with_poses(scene: LiberoScene, starts: State, poses: np.ndarray) -> State:
    """Returns the states, objects put into poses (rows, objects, 7) in the order of the task file."""
    seated = torch.from_numpy(poses)
    for index, name in enumerate(scene.problem.objects):
        starts.objects[name].pos, starts.objects[name].rot = seated[:, index, :3], seated[:, index, 3:]
    return starts


def _stored(path: Path, shape: tuple[int, ...]) -> np.ndarray | None:
    """Returns the poses of a file of the cache; None if there is none, or a damaged one: it is made again."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            poses = stored["poses"]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return poses if poses.shape == shape and np.isfinite(poses).all() else None


def _name(entry: Entry, scene: LiberoScene) -> str:
    files = [problem_file(entry), start_file(entry)]
    digest = hashlib.sha256(json.dumps([_VERSION, mujoco.__version__]).encode())
    for path in files:
        digest.update(path.read_bytes())
    for item in scene.scenario.objects:  # the names of imported files follow from their contents
        digest.update(f"{item.name} {Path(item.mjcf or '').name} {item.pos} {item.rot}".encode())
    return digest.hexdigest()[:32]


class Seater:
    """Seats the objects of a scene, without its robot.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: LiberoScene) -> None:
        self._scene = scene
        scenario = replace(scene.scenario, robots=(), cameras=())
        self._model = build_models(scenario)[1]
        self._data = mujoco.MjData(self._model)
        self._layout: Layout = layout_of(self._model, scenario)
        self._movable = [item for item in self._layout.objects if item.name in scene.problem.objects]
        order = {name: place for place, name in enumerate(scene.problem.objects)}
        self._movable.sort(key=lambda item: order[item.name])
        roots = np.asarray(self._model.body_rootid)[np.asarray(self._model.geom_bodyid)]
        self._geoms = {item.name: roots == self._model.body(item.name).id for item in self._movable}

    def poses(self, starts: State) -> np.ndarray:
        """Returns the seated poses of all rows, (rows, objects, 7), in the order of the task file."""
        return np.array([self.seat(starts, row)[0] for row in range(starts.num_envs)])

    def seat(self, starts: State, row: int) -> tuple[np.ndarray, Seat]:
        """Returns the seated poses (objects, 7) of one row of states, and how well that went."""
        data = self._data
        mujoco.mj_resetData(self._model, data)
        self._place_fixtures(starts, row)
        given = [
            torch.cat([starts.objects[item.name].pos[row], starts.objects[item.name].rot[row]]).numpy()
            for item in self._movable
        ]
        for place, item in enumerate(self._movable):  # out of the way until it is their turn
            data.qpos[item.root_qpos : item.root_qpos + 3] = (_AWAY_M + place, 0.0, _AWAY_M)
        heights = [float(np.ptp(self._scene_points(starts, row, item.name)[:, 2])) for item in self._movable]
        # Lowest first; of two that hang equally high the flatter one, whose rim a bowl may reach over.
        for place in sorted(range(len(given)), key=lambda i: (round(float(given[i][2]), 2), heights[i])):
            item = self._movable[place]
            data.qpos[item.root_qpos : item.root_qpos + 7] = given[place]
            self._put_down(item.name, item.root_qpos + 2)
        data.qvel[:] = 0.0
        data.qacc_warmstart[:] = 0.0
        for _ in range(round(SETTLE_S / self._model.opt.timestep)):
            mujoco.mj_step(self._model, data)
        poses = np.stack([data.qpos[item.root_qpos : item.root_qpos + 7] for item in self._movable])
        speeds = [np.linalg.norm(data.qvel[item.root_qvel : item.root_qvel + 3]) for item in self._movable]
        before = np.array(given)
        moved = np.linalg.norm(poses[:, :2] - before[:, :2], axis=1)
        cosine = np.abs(np.sum(_up(poses[:, 3:]) * _up(before[:, 3:]), axis=1))
        seat = Seat(float(moved.max()), float(np.arccos(np.clip(cosine, 0, 1)).max()), float(max(speeds)))
        return poses, seat

    def _scene_points(self, starts: State, row: int, name: str) -> np.ndarray:
        """Returns points of an object in one of the states, (P, 3)."""
        return cloud(self._scene.parts[name], starts.objects[name].select(torch.tensor([row])))

    def _place_fixtures(self, starts: State, row: int) -> None:
        for item in self._layout.objects:
            entity = starts.objects[item.name]
            if item.root == "mocap":
                self._data.mocap_pos[item.mocap] = entity.pos[row].numpy()
                self._data.mocap_quat[item.mocap] = entity.rot[row].numpy()
            if len(item.qpos):
                self._data.qpos[item.qpos] = entity.joint_pos[row].numpy()

    def _put_down(self, name: str, height: int) -> None:
        """Raises an object out of what it overlaps, and lowers it to its first touch."""
        qpos, own = self._data.qpos, self._geoms[name]
        limit = qpos[height] + MOST_RAISED_M
        while self._overlaps(own) and qpos[height] < limit:
            qpos[height] += RAISE_STEP_M
        free, limit = float(qpos[height]), qpos[height] - MOST_LOWERED_M
        while not self._overlaps(own):
            free = float(qpos[height])
            if free < limit:  # nothing is below it: it falls when all settle
                return
            qpos[height] -= LOWER_STEP_M
        held = float(qpos[height])
        while free - held > TOUCH_M:
            qpos[height] = middle = (free + held) / 2
            held, free = (middle, free) if self._overlaps(own) else (held, middle)
        qpos[height] = free

    def _overlaps(self, own: np.ndarray) -> bool:
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        contact = self._data.contact
        mine = own[contact.geom1] | own[contact.geom2]
        return bool((mine & (contact.dist < 0.0)).any())


def _up(quats: np.ndarray) -> np.ndarray:
    """Returns what is vertical in the world, in the frame of each orientation (n, 4), (n, 3)."""
    w, x, y, z = quats.T
    return np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1)
