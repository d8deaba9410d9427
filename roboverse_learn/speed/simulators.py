"""Handlers against scripts on the simulator alone: ``roboverse speed simulators``.

Ours takes targets, steps, and returns the states of all robots and objects. The script works with a scene
that a handler has built, so that both have the same bodies and gains: it sets targets, steps, and reads
joints, the pose of the hand, and the pose and velocity of the cube once per control step, in the simulator's
own conventions. Times are processor time, which a busy machine hardly changes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time
from typing import Any

import mujoco
import numpy as np

from roboverse_learn.speed.harness import Call, Goal, Measurement, Program, part_each, require_same_physics

TASK = "PickCube"
GOAL = Goal(1.15, at_least=False)

type Script = tuple[Callable[[np.ndarray, int], object], Callable[[], np.ndarray]]
"""Makes a control step of some physics steps towards a target (J,), and reads what such a script reads; and
returns the positions of the driven joints, in the simulator's order."""


def mujoco_script(handler: Any, robot: Any) -> Script:
    """``mj_step`` on an ``MjData`` of its own."""
    model, data = handler.model, mujoco.MjData(handler.model)
    (start,) = handler.snapshot()
    data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = start.qpos, start.mocap_pos, start.mocap_quat
    data.ctrl[robot.ctrl] = handler.get_joint_targets(robot.name)[0]
    mujoco.mj_step(model, data)
    hand = data.site(robot.ee_site)

    def step(target: np.ndarray, num_steps: int) -> object:
        data.ctrl[robot.ctrl] = target
        mujoco.mj_step(model, data, num_steps)
        return data.qpos.copy(), data.qvel.copy(), hand.xpos.copy(), hand.xmat.copy()

    return step, lambda: data.qpos[robot.qpos]


def sapien_script(handler: Any, robot: Any) -> Script:
    """Drive targets, ``PhysxSystem.step``, and the poses of entities."""
    handler.step(1)
    system = handler.worlds[0].native.physx_system
    links = system.articulation_link_components
    arm = next(link.articulation for link in links if link.name.startswith(f"{robot.name}/"))
    joints = [joint for joint in arm.get_active_joints() if joint.stiffness > 0.0]
    hand, cube = arm.links[-1].entity, system.rigid_dynamic_components[0]

    def step(target: np.ndarray, num_steps: int) -> object:
        for joint, value in zip(joints, target.tolist(), strict=True):
            joint.set_drive_target(value)
        for _ in range(num_steps):
            system.step()
        poses = (pose := cube.entity.pose).p, pose.q, (end := hand.pose).p, end.q
        return arm.get_qpos(), arm.get_qvel(), poses, cube.linear_velocity, cube.angular_velocity

    return step, arm.get_qpos


def pybullet_script(handler: Any, robot: Any) -> Script:
    """``stepSimulation`` with the motors' velocities and forces set before each step.

    How the motors are driven, :mod:`envs.simulators.pybullet.drives`, is part of the physics that is
    compared: Bullet's own position control has other gains.
    """
    import pybullet as bullet

    handler.step(1)
    world = handler.worlds[0]
    client = {"physicsClientId": world.client}
    joints = {body: bullet.getNumJoints(body, **client) for body in range(bullet.getNumBodies(**client))}
    arm = max(joints, key=joints.__getitem__)
    single = [body for body, count in joints.items() if count == 0]
    cube = next(body for body in single if bullet.getDynamicsInfo(body, -1, **client)[0] > 0.0)
    drives = max(world.drives, key=lambda each: len(each.dofs))
    ctrl = np.zeros(handler.model.nu)

    def step(target: np.ndarray, num_steps: int) -> object:
        ctrl[robot.ctrl] = target
        drives.aim(ctrl)
        drives.linearize()
        for _ in range(num_steps):
            drives.push()
            bullet.stepSimulation(**client)
        return (
            bullet.getJointStates(arm, drives.indices, **client),
            bullet.getBasePositionAndOrientation(cube, **client),
            bullet.getBaseVelocity(cube, **client),
            bullet.getLinkState(arm, joints[arm] - 1, computeForwardKinematics=1, **client),
        )

    return step, lambda: drives.read()[0]


SCRIPTS: dict[str, Callable[[Any, Any], Script]] = {
    "mujoco": mujoco_script,
    "sapien": sapien_script,
    "pybullet": pybullet_script,
}
"""Simulators to their scripts; each makes one physics step from the state that the handler was set to."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Simulators(Program):
    """Compares handlers to scripts on the simulator alone.

    Attributes:
        parts: mujoco, sapien, pybullet.
        turns: How often each side is timed.
    """

    turns: int = 11

    @part_each(*SCRIPTS)
    def overhead(self, simulator: str, control_steps: int = 20) -> Measurement:
        """Compares control steps of one environment to a script over the same scene, with the same end."""
        handler, scene = (launched(simulator, renderer="warp", num_threads=1) for _ in range(2))
        robot, decimation = handler.scenario.robots[0], handler.scenario.physics.decimation
        states = handler.get_states()
        start = states.robots[robot.name].joint_pos.numpy()
        low, high = np.array([joint.range for joint in robot.joints]).T
        targets = [np.clip(start + 0.05 * np.sin(0.3 * step), low, high) for step in range(control_steps)]
        layout = next(item for item in scene.layout.robots if item.name == robot.name)
        script: list[Any] = []

        def begin() -> None:
            handler.set_states(states)
            scene.set_states(states)
            handler.step(1)  # rebuilds what a set state invalidates, outside the timed part
            script[:] = SCRIPTS[simulator](scene, layout)

        def theirs() -> None:
            for target in targets:
                script[0](target[0], decimation)

        def check() -> None:
            joints = handler.get_states().robots[robot.name].joint_pos[0].numpy()
            require_same_physics(np.abs(np.sort(joints) - np.sort(script[1]())).max())

        name = f"{simulator}: control step of {TASK}, handler / script on the simulator alone"
        how: Any = {"units": control_steps, "clock": process_time, "before": begin, "after": check}
        with handler, scene:
            return self.compare(name, controlled(handler, targets), theirs, GOAL, **how)


def launched(
    simulator: str, num_envs: int = 1, image_size: int | None = None, settings: Any = None, **options: Any
) -> Any:
    """Returns a handler with one camera, the task's own or of a size, at the task's initial states."""
    from envs.simulators import HANDLERS
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = task.scenario.seen_by(image_size=image_size).tuned(simulator, settings or {})
    handler: Any = HANDLERS.get(simulator)(scenario, num_envs, **options)
    handler.launch()
    handler.set_states(task.initial_state([np.random.default_rng(index) for index in range(num_envs)]))
    return handler


def controlled(handler: Any, targets: Sequence[Any]) -> Call:
    """Returns control steps of a handler's first robot: each sets a target, steps and returns the states."""
    robot, decimation = handler.scenario.robots[0].name, handler.scenario.physics.decimation

    def control() -> None:
        for target in targets:
            handler.set_joint_targets({robot: target})
            handler.step(decimation)
            handler.get_states()

    return control
