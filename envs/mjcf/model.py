"""Compiles a :class:`~envs.scenario.ScenarioCfg` to a ``mujoco.MjModel``.

One compiled model serves every appearance of a level: it has a material and a texture slot per surface, a
slot per light, and a table top that can be turned.
"""

import mujoco
import numpy as np

from envs.core.errors import unknown_name
from envs.mjcf.contact_exclusions import pairs_never_in_contact
from envs.mjcf.furniture import add_furniture_slots
from envs.mjcf.meshes import VISUAL_GROUP
from envs.mjcf.objects import HIDDEN_GROUP, SCENE_GROUP, SHAPES, add_object, add_pull
from envs.mjcf.robots import add_robot
from envs.mjcf.settings import MujocoSettings
from envs.rotations import look_at_matrix
from envs.scenario import (
    GROUND,
    SURFACES,
    CameraCfg,
    ObjectCfg,
    PhysicsCfg,
    RobotCfg,
    ScenarioCfg,
)
from envs.scenario.places import WALL_HALF_THICKNESS_M

LEAST_LIGHTS = 8
"""Slots for lights that every model has; dark ones cost nothing."""

TEXTURE_SIZE = 256
"""Side of a surface's texture, pixels."""

TABLE_BODY = "table_top"

OBJECT_MATERIAL = "objects"


def build_model(scenario: ScenarioCfg, *, simplify: bool = True) -> mujoco.MjModel:
    """Compiles the scenario.

    Args:
        scenario: The scene.
        simplify: Render the robots with merged and simplified visual meshes.

    Returns:
        The model; robots' names are prefixed by ``<robot>/``.
    """
    return _for_rendering(_scene_spec(scenario, simplify))


def build_models(
    scenario: ScenarioCfg, *, simplify: bool = True, prune: bool = False
) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    """Compiles the scenario twice: for rendering, and for simulation.

    The second has no visual geoms. Its states are bit-identical to the first's, and a step is 10 % faster;
    bodies, joints, sites, sensors and actuators have the same ids in both.

    Args:
        scenario: The scene.
        simplify: Render the robots with simplified meshes.
        prune: Do not look for contacts of bodies that cannot touch; see
            :mod:`envs.mjcf.contact_exclusions`.
    """
    spec = _scene_spec(scenario, simplify)
    rendered = _for_rendering(spec)
    spec.compiler.discardvisual = True
    simulated = spec.compile()
    apart = pairs_never_in_contact(simulated) if prune else []
    for one, other in apart:
        spec.add_exclude(bodyname1=one, bodyname2=other)
    return rendered, spec.compile() if apart else simulated


def _for_rendering(spec: mujoco.MjSpec) -> mujoco.MjModel:
    model = spec.compile()
    # Robots and objects keep their colours and share one material, which says how they reflect.
    seen = np.isin(model.geom_group, (VISUAL_GROUP, SCENE_GROUP))
    model.geom_matid[seen & (model.geom_matid < 0)] = model.material(OBJECT_MATERIAL).id
    return model


def _scene_spec(scenario: ScenarioCfg, simplify: bool) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    _set_physics(spec, scenario.physics)
    MujocoSettings.of(scenario).write(spec.option)
    _add_surfaces(spec, scenario)
    for index in range(light_slots(scenario)):
        spec.worldbody.add_light(name=f"light{index}", active=False, castshadow=index == 0)
    for robot in scenario.robots:
        add_robot(spec, robot, simplify)
    for item in scenario.objects:
        add_object(spec, item)
    for item in scenario.objects:
        add_pull(spec, item)
    for camera in scenario.cameras:
        _add_camera(spec, camera)
    for item in (*scenario.robots, *scenario.objects):
        _add_touches(spec, scenario, item)
    spec.add_material(name=OBJECT_MATERIAL)
    return spec


def light_slots(scenario: ScenarioCfg) -> int:
    """Returns how many lights an appearance may have: the scenario's own or those of the lighting channel."""
    return max(LEAST_LIGHTS, len(scenario.appearance.lights), 1 + scenario.lighting.num_lamps)


def _set_physics(spec: mujoco.MjSpec, physics: PhysicsCfg) -> None:
    spec.compiler.degree = False
    option = spec.option
    option.timestep = physics.timestep_s
    option.gravity = physics.gravity
    spec.stat.extent = 2.0
    spec.stat.center = (0.0, 0.0, 0.0)
    spec.visual.map.znear = 0.005
    spec.visual.map.zfar = 20.0
    spec.visual.headlight.active = 0
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 2048
    spec.visual.global_.offwidth = spec.visual.global_.offheight = 1024


def _add_surfaces(spec: mujoco.MjSpec, scenario: ScenarioCfg) -> None:
    for surface in SURFACES:
        spec.add_texture(
            name=surface,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=(1, 1, 1),
            rgb2=(1, 1, 1),
            width=TEXTURE_SIZE,
            height=TEXTURE_SIZE,
        )
        material = spec.add_material(name=surface)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = surface
    world, table, room = spec.worldbody, scenario.table, scenario.room
    ground_z = scenario.floor_z
    half = scenario.ground_half_size_m if room is None else room.half_size_m
    world.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(half, half, 0.1),
        pos=(0, 0, ground_z),
        material="ground",
        group=SCENE_GROUP,
    )
    if room is not None:
        _add_walls(spec, half, room.height_m, ground_z)
        add_furniture_slots(spec, room.half_size_m, ground_z)
    if table is not None:
        size = (*table.half_size, table.thickness_m / 2)
        centre = (table.pos[0], table.pos[1], table.pos[2] - table.thickness_m / 2)
        if table.collides:
            world.add_geom(name="table_collision", type=SHAPES["box"], size=size, pos=centre, group=0)
        top = world.add_body(name=TABLE_BODY, pos=centre, mocap=True)
        group = SCENE_GROUP if table.visible else HIDDEN_GROUP
        seen = {"contype": 0, "conaffinity": 0, "group": group, "material": "table"}
        top.add_geom(name="table", type=SHAPES["box"], size=size, **seen)
        reach_x, reach_y = table.half_size[0] - 0.08, table.half_size[1] - 0.08
        leg = (table.height_m - table.thickness_m) / 2
        for sign_x in (-1, 1):
            for sign_y in (-1, 1):
                top.add_geom(
                    type=SHAPES["box"],
                    size=(0.04, 0.04, leg),
                    pos=(sign_x * reach_x, sign_y * reach_y, -leg - table.thickness_m / 2),
                    **seen,
                )


def _add_walls(spec: mujoco.MjSpec, half: float, height: float, ground_z: float) -> None:
    thickness = WALL_HALF_THICKNESS_M
    for name, x, y in (("x+", 1, 0), ("x-", -1, 0), ("y+", 0, 1), ("y-", 0, -1)):
        spec.worldbody.add_geom(
            name=f"wall_{name}",
            type=SHAPES["box"],
            size=(thickness if x else half, thickness if y else half, height / 2),
            pos=(x * half, y * half, ground_z + height / 2),
            material="wall",
            contype=0,
            conaffinity=0,
            group=SCENE_GROUP,
        )


def touch_sensor(feeling: str, felt: str) -> str:
    """Returns the name of the sensor of whether something touches a robot or an object."""
    return f"{feeling}/touched_by/{felt}"


def _add_touches(spec: mujoco.MjSpec, scenario: ScenarioCfg, item: RobotCfg | ObjectCfg) -> None:
    """Adds a sensor for each thing that a robot or an object feels: how many of their geoms touch."""
    roots = {robot.name: f"{robot.name}/{robot.root}" for robot in scenario.robots}
    for other in item.feels:
        is_ground = other == GROUND
        sensor = spec.add_sensor(
            name=touch_sensor(item.name, other),
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_XBODY,
            objname=roots.get(item.name, item.name),
            reftype=mujoco.mjtObj.mjOBJ_GEOM if is_ground else mujoco.mjtObj.mjOBJ_XBODY,
            refname=GROUND if is_ground else roots.get(other, other),
        )
        sensor.intprm[:3] = (1, 0, 1)  # found, as they come, one


def _add_camera(spec: mujoco.MjSpec, camera: CameraCfg) -> None:
    body = spec.worldbody if camera.mount is None else spec.body(camera.mount)
    if body is None:
        names = [body.name for body in spec.bodies]
        raise unknown_name(f"body that carries the camera '{camera.name}'", str(camera.mount), names)
    going_along = mujoco.mjtCamLight.mjCAMLIGHT_TRACK
    body.add_camera(
        name=camera.name,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_FIXED if camera.turns else going_along,
        pos=camera.pos,
        quat=camera_quat(camera),
        fovy=camera.fovy_deg,
        resolution=(camera.width, camera.height),
    )


def camera_quat(camera: CameraCfg) -> np.ndarray:
    """Returns the orientation of a camera in the frame of what carries it, wxyz."""
    quat = np.zeros(4)
    matrix = look_at_matrix(np.array(camera.pos), np.array(camera.look_at), camera.up)
    mujoco.mju_mat2Quat(quat, matrix.ravel())
    return quat
