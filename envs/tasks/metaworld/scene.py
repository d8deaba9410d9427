"""Meta-World's scenes as scenarios: its Sawyer and its objects, on our table, in our light."""

from dataclasses import dataclass
from functools import cache
from math import pi, sqrt

import mujoco
import numpy as np
import torch

from envs.robots.sawyer import SAWYER, SAWYER_HAND
from envs.scenario import SURFACES, CameraCfg, GeomCfg, ObjectCfg, PhysicsCfg, ScenarioCfg, TableCfg
from envs.state import EntityState, State
from envs.tasks.metaworld.original import Original, Pose
from envs.tasks.tabletop import TABLETOP_LOOKS

PULLER, GOAL = "hand_target", "goal"

PULLER_ROT = (sqrt(0.5), 0.0, sqrt(0.5), 0.0)
"""Meta-World's (1, 0, 1, 0), normalized: the gripper points down."""

VECTOR_MARKERS = ("random_vector_0", "random_vector_1")
"""Invisible markers at the positions that make up an episode's random vector."""

_SHOWN_GROUPS = (0, 1, 2)
"""Geom groups that MuJoCo's viewer, and so Meta-World, shows; 4 has collision shapes."""

_TABLE, _WALL = "tablelink", "RetainingWall"
_NO_OBJECTS = {"world", "base", "mocap"}
_WORKSPACE = (0.0, 0.6, 0.0)

_CAMERA = CameraCfg(
    name="front",
    pos=(1.125, -0.05, 0.75),
    look_at=(0.0, 0.65, 0.13),
    fovy_deg=34.0,
    orbit_pos=_WORKSPACE,
    orbit_yaw_rad=-pi / 6,
)
"""It looks past the robot onto the objects' fronts, from the position of Meta-World's ``corner2``."""


@dataclass(frozen=True, slots=True)
class _Part:
    """One body of Meta-World's scene that is an object of ours."""

    name: str
    body: str
    body_id: int
    free_qpos: int
    free_qvel: int
    joint_names: tuple[str, ...]
    qpos: tuple[int, ...]
    qvel: tuple[int, ...]


class MetaworldScene:
    """A scenario, and the way between its states and Meta-World's arrays.

    Args:
        original: The environment.

    Attributes:
        scenario: The scenario.
    """

    def __init__(self, original: Original) -> None:
        self._original = original
        self._parts = tuple(_parts(original.model))
        names = SAWYER.joint_names
        joints = [original.model.joint(name) for name in names]
        self._arm_qpos = np.array([joint.qposadr[0] for joint in joints])
        self._arm_qvel = np.array([joint.dofadr[0] for joint in joints])
        self._markers = VECTOR_MARKERS[: original.vector_size // 3]
        self.scenario = self._scenario()

    def _scenario(self) -> ScenarioCfg:
        env, option = self._original.env, self._original.model.opt
        # Where the table has a hole, Meta-World's own is rendered.
        flat = any(part.body == _WALL for part in self._parts)
        objects = [
            ObjectCfg(
                name=part.name,
                mjcf=self._original.scene,
                mjcf_root=part.body,
                mjcf_joints=part.joint_names,
                mjcf_shown=() if flat and part.body == _TABLE else _SHOWN_GROUPS,
                pos=tuple(self._original.model.body_pos[part.body_id]),
                rot=tuple(self._original.model.body_quat[part.body_id]),
                kind="free" if part.free_qpos >= 0 else "fixed",
            )
            for part in self._parts
        ]
        objects.append(_marker(PULLER, 0.01, visible=False, pulls=f"{SAWYER.name}/{SAWYER_HAND}"))
        objects.append(_marker(GOAL, 0.02, visible=True))
        objects.extend(_marker(name, 0.01, visible=False) for name in self._markers)
        return ScenarioCfg(
            robots=(SAWYER,),
            objects=tuple(objects),
            cameras=(_CAMERA,),
            appearance=TABLETOP_LOOKS,
            # Meta-World's own table collides, and is not rendered.
            table=TableCfg(
                pos=_WORKSPACE, half_size=(0.85, 0.85), height_m=0.913, collides=False, visible=flat
            ),
            physics=PhysicsCfg(timestep_s=float(option.timestep), decimation=int(env.frame_skip)),
            simulators={"mujoco": _solver(option)},
        )

    def state(self, starts: list[Pose], goals: np.ndarray, vectors: np.ndarray) -> State:
        """Returns the state of N poses, their goals (N, 3) and their random vectors (N, 3 or 6)."""
        qpos, qvel = (np.stack([getattr(start, key) for start in starts]) for key in ("qpos", "qvel"))
        robot = EntityState.at_rest(
            np.zeros(3), np.tile(SAWYER.rot, (len(starts), 1)), qpos[:, self._arm_qpos]
        )
        robot.joint_vel = torch.from_numpy(qvel[:, self._arm_qvel])
        robot.joint_target = torch.from_numpy(np.stack([start.ctrl for start in starts]))
        objects = {part.name: self._entity(part, starts, qpos, qvel) for part in self._parts}
        pulled = np.stack([start.mocap_pos for start in starts])
        objects[PULLER] = EntityState.at_rest(pulled, np.array(PULLER_ROT))
        upright = np.array((1.0, 0.0, 0.0, 0.0))
        objects[GOAL] = EntityState.at_rest(goals, upright)
        for index, name in enumerate(self._markers):
            objects[name] = EntityState.at_rest(vectors[:, 3 * index : 3 * index + 3], upright)
        return State({SAWYER.name: robot}, objects)

    def _entity(self, part: _Part, starts: list[Pose], qpos: np.ndarray, qvel: np.ndarray) -> EntityState:
        joints = qpos[:, list(part.qpos)]
        if part.free_qpos < 0:
            pos = np.stack([start.body_pos[part.body_id] for start in starts])
            entity = EntityState.at_rest(pos, self._original.model.body_quat[part.body_id], joints)
        else:
            first, speed = part.free_qpos, part.free_qvel
            entity = EntityState.at_rest(qpos[:, first : first + 3], qpos[:, first + 3 : first + 7], joints)
            entity.lin_vel = torch.from_numpy(qvel[:, speed : speed + 3].copy())
            entity.ang_vel = torch.from_numpy(qvel[:, speed + 3 : speed + 6].copy())
        entity.joint_vel = torch.from_numpy(qvel[:, list(part.qvel)])
        return entity

    def poses(self, state: State) -> tuple[list[Pose], np.ndarray]:
        """Returns each environment's pose, and the random vectors (N, 3 or 6); inverts :meth:`state`."""
        model, count = self._original.model, state.num_envs
        robot = state.robots[SAWYER.name]
        assert robot.joint_target is not None, "a simulator gives every robot's targets"
        qpos, qvel = np.zeros((count, model.nq)), np.zeros((count, model.nv))
        qpos[:, self._arm_qpos], qvel[:, self._arm_qvel] = _array(robot.joint_pos), _array(robot.joint_vel)
        body_pos = np.tile(model.body_pos, (count, 1, 1))
        for part in self._parts:
            entity = state.objects[part.name]
            qpos[:, list(part.qpos)], qvel[:, list(part.qvel)] = map(
                _array, (entity.joint_pos, entity.joint_vel)
            )
            if part.free_qpos < 0:
                body_pos[:, part.body_id] = _array(entity.pos)
                continue
            first, speed = part.free_qpos, part.free_qvel
            qpos[:, first : first + 3], qpos[:, first + 3 : first + 7] = map(_array, (entity.pos, entity.rot))
            qvel[:, speed : speed + 3], qvel[:, speed + 3 : speed + 6] = map(
                _array, (entity.lin_vel, entity.ang_vel)
            )
        ctrl, pulled = _array(robot.joint_target), _array(state.objects[PULLER].pos)
        vectors = np.concatenate([_array(state.objects[name].pos) for name in self._markers], axis=1)
        return [Pose(*row) for row in zip(qpos, qvel, ctrl, pulled, body_pos, strict=True)], vectors


@cache
def scene_of(original: Original) -> MetaworldScene:
    """Returns the scene of an environment."""
    return MetaworldScene(original)


def _array(values: torch.Tensor) -> np.ndarray:
    return values.cpu().numpy()


def _marker(name: str, radius_m: float, *, visible: bool, pulls: str | None = None) -> ObjectCfg:
    ball = GeomCfg(shape="sphere", size=(radius_m,), rgba=(0.0, 0.8, 0.0, 1.0), visible=visible)
    return ObjectCfg(name=name, geoms=(ball,), kind="marker", pulls=pulls)


def _parts(model: mujoco.MjModel) -> list[_Part]:
    parts = []
    free = int(mujoco.mjtJoint.mjJNT_FREE)
    for body_id in range(1, model.nbody):
        name = model.body(body_id).name or f"body{body_id}"
        if model.body_parentid[body_id] != 0 or name in _NO_OBJECTS:
            continue
        joints = [j for j in range(model.njnt) if model.body_rootid[model.jnt_bodyid[j]] == body_id]
        loose = [j for j in joints if model.jnt_type[j] == free]
        held = [j for j in joints if model.jnt_type[j] != free]
        parts.append(
            _Part(
                name=f"{name}_object" if name in SURFACES else name,
                body=name,
                body_id=body_id,
                free_qpos=int(model.jnt_qposadr[loose[0]]) if loose else -1,
                free_qvel=int(model.jnt_dofadr[loose[0]]) if loose else -1,
                joint_names=tuple(
                    model.joint(j).name or model.body(int(model.jnt_bodyid[j])).name for j in held
                ),
                qpos=tuple(int(model.jnt_qposadr[j]) for j in held),
                qvel=tuple(int(model.jnt_dofadr[j]) for j in held),
            )
        )
    return parts


def _solver(option: mujoco.MjOption) -> dict[str, str | float | int]:
    """Returns the settings of the scene's file, for MuJoCo."""
    from envs.mjcf.settings import CONES, INTEGRATORS, JACOBIANS

    def named(value: int, names: dict[str, object]) -> str:
        return next(name for name, kind in names.items() if int(kind) == int(value))  # type: ignore[call-overload]

    return {
        "integrator": named(option.integrator, INTEGRATORS),
        "cone": named(option.cone, CONES),
        "jacobian": named(option.jacobian, JACOBIANS),
        "impratio": float(option.impratio),
        "iterations": int(option.iterations),
        "tolerance": float(option.tolerance),
    }
