"""A compiled scene in Bullet's formats: a URDF file per robot or object, and the static bodies."""

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from envs.convert.description import Description, Link
from envs.convert.read import read_model
from envs.convert.urdf import write_urdf
from envs.core.assets import cache_dir
from envs.core.atomic import cached_directory
from envs.core.errors import SimulatorError
from envs.mjcf.link_tree import tied

_VERSION = 2


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """A robot or an object: the connected links below one body of the world.

    Attributes:
        urdf: What Bullet loads.
        description: What was written there.
        body: Its uppermost body.
        free: Whether it moves freely; if not it stays where it is put.
        qpos: Address of its free joint in qpos, or -1.
        dof: Address of its free joint in qvel, or -1.
        mocap: Index of what is put in place, or -1.
        touches_own_root: Links touch the root that they are jointed to.
    """

    urdf: Path
    description: Description
    body: int
    free: bool
    qpos: int
    dof: int
    mocap: int
    touches_own_root: bool


def trees_of(model: mujoco.MjModel) -> tuple[Tree, ...]:
    """Writes every robot and object of a scene that moves or is touched.

    Raises:
        SimulatorError: if a joint is a ball joint, an actuator does not drive a joint to a position, or
            there is an equality constraint or a tendon.
    """
    _check(model)
    folder = cache_dir("pybullet") / _digest(model)
    trees = []
    for body in range(1, model.nbody):
        if model.body_parentid[body] == 0:
            description = _without_looks(read_model(model, f"tree{body}", root=body))
            if (
                description.joints
                or description.floating
                or any(link.collisions for link in description.links)
            ):
                trees.append(_tree(model, body, description, folder))
    if not folder.is_dir():
        _write([tree.description for tree in trees], folder)
    return tuple(trees)


def still_geoms(model: mujoco.MjModel) -> tuple[int, ...]:
    """Returns the geoms of the world itself that touch something."""
    own = model.geom_bodyid == 0
    return tuple(
        int(geom) for geom in np.flatnonzero(own & ((model.geom_contype | model.geom_conaffinity) > 0))
    )


def _tree(model: mujoco.MjModel, body: int, description: Description, folder: Path) -> Tree:
    free = description.floating
    joint = int(model.body_jntadr[body])
    pairs = {int(model.geom_bodyid[geom]) for geom in (*model.pair_geom1, *model.pair_geom2)}
    return Tree(
        urdf=folder / description.name / f"{description.name}.urdf",
        description=description,
        body=body,
        free=free,
        qpos=int(model.jnt_qposadr[joint]) if free else -1,
        dof=int(model.jnt_dofadr[joint]) if free else -1,
        mocap=int(model.body_mocapid[body]),
        touches_own_root=any(int(model.body_rootid[other]) == body for other in pairs),
    )


def _without_looks(description: Description) -> Description:
    """Removes visual shapes, and what :mod:`envs.simulators.pybullet.drives` does in Bullet's place."""

    def touched(link: Link) -> Link:
        return replace(link, visuals=(), joint=replace(link.joint, damping=0.0, friction=0.0, armature=0.0))

    return replace(description, links=tuple(touched(link) for link in description.links))


def _write(descriptions: list[Description], folder: Path) -> None:
    with cached_directory(folder) as working:
        for description in descriptions:
            (working / description.name).mkdir()
            write_urdf(description, working / description.name)


def _check(model: mujoco.MjModel) -> None:
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            raise SimulatorError(
                f"simulator=pybullet has no ball joint such as '{model.joint(joint).name}'. "
                "Take simulator=mujoco, or give the body three hinges."
            )
    if model.neq:
        first, second = tied(model)
        raise SimulatorError(
            f"simulator=pybullet has no equality constraint such as that of '{first}' and '{second}'. "
            "Take simulator=mujoco."
        )
    if model.ntendon:
        raise SimulatorError(
            f"simulator=pybullet has no tendon such as '{model.tendon(0).name}'. Take simulator=mujoco."
        )
    for index in range(model.nu):
        position = model.actuator_biastype[index] == mujoco.mjtBias.mjBIAS_AFFINE
        if model.actuator_trntype[index] != mujoco.mjtTrn.mjTRN_JOINT or not position:
            raise SimulatorError(
                f"The actuator '{model.actuator(index).name}' does not drive a joint to a position, which is "
                "all that simulator=pybullet does. Take simulator=mujoco."
            )


def _digest(model: mujoco.MjModel) -> str:
    buffer = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, buffer)
    return hashlib.sha256(bytes([_VERSION]) + buffer.tobytes()).hexdigest()[:24]
