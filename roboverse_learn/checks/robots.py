"""Contracts of a robot, alone on the ground or at its place."""

from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch

from envs.kinematics.inverse import PathFollower
from envs.kinematics.waypoints import Waypoint
from envs.mjcf.drives import rest_targets
from envs.robots import ROBOTS
from envs.scenario import PhysicsCfg, RobotCfg, ScenarioCfg
from envs.simulators import HANDLERS
from envs.simulators.base import Handler
from envs.simulators.model_handler import ModelHandler
from envs.state import EntityState, State
from roboverse_learn.checks.contract import Contract, NotApplicableError, contract, counted, require

_PHYSICS = PhysicsCfg(timestep_s=0.002, decimation=25)
"""Steps of 2 ms, 20 control steps a second: those of the table-top tasks."""

_STAND_S, _STEP_S = 2.0, 1.5
_SAG_RAD, _MISSED_RAD = 0.05, 0.05
_TIED_RAD = 1e-6
_SHARE, _GRIPPER_SHARE = 0.1, 0.4
"""Share of its range that a joint of the arm, and one of the gripper, is commanded to move."""

_MOST_RAD = 0.3
"""Most that a joint of the arm is moved: one that may turn by a whole turn would reach the ground."""

_WAY_M, _OFF_M = 0.05, 0.01

_SPEED = 0.2
"""Speed at which joints start that are set and set again, rad/s (m/s)."""

_STEPS, _DISTURBED_S = 10, 0.5

_PARTS = {"rot": ("w", "x", "y", "z")} | dict.fromkeys(("pos", "lin_vel", "ang_vel"), ("x", "y", "z"))
"""Components of what a robot's base has."""


class CheckedRobot:
    """A robot under test in a simulator. Close it when it is done with.

    Args:
        name: Registered robot.
        simulator: Registered simulator.
    """

    def __init__(self, name: str, simulator: str = "mujoco") -> None:
        self.name, self.simulator = name, simulator

    @cached_property
    def robot(self) -> RobotCfg:
        """What is registered."""
        return ROBOTS.get(self.name)

    @cached_property
    def handler(self) -> Handler:
        """The simulator with the robot alone."""
        scene = ScenarioCfg(robots=(self.robot,), table=None, physics=_PHYSICS)
        handler = HANDLERS.get(self.simulator)(scene, 1, num_threads=1)
        handler.launch()
        return handler

    def start(self) -> None:
        """Puts the robot into its rest posture."""
        robot = self.robot
        qpos = np.array(robot.default_qpos)[None]
        start = EntityState.at_rest(np.array(robot.pos), np.array([robot.rot]), qpos)
        self.handler.set_states(State({robot.name: start}, {}))

    def hold(self, targets: np.ndarray, seconds: float) -> EntityState:
        """Holds targets of the driven joints (D,); returns the state at the end, on the CPU."""
        for _ in range(round(seconds * _PHYSICS.control_hz)):
            self.handler.set_joint_targets({self.robot.name: targets[None]})
            self.handler.step(_PHYSICS.decimation)
        return self.handler.get_states().to("cpu").robots[self.robot.name]

    @property
    def rest(self) -> np.ndarray:
        """Targets at rest of the driven joints, (D,)."""
        return rest_targets(self.robot)

    @property
    def positions(self) -> list[int]:
        """Indices of joints whose target is their position, within their range."""
        joints = self.robot.joints
        return [
            index
            for index in self.robot.driven
            if joints[index].drive == "position"
            and joints[index].target_range in (None, joints[index].range)
            and not joints[index].pulls
        ]

    def close(self) -> None:
        """Frees the simulator."""
        if "handler" in self.__dict__:
            self.handler.close()


@contract()
def joints(checked: CheckedRobot) -> str:
    """Each joint has a name of its own, limits, a rest between them, and a gain where it is driven."""
    robot = checked.robot
    require(
        isinstance(robot, RobotCfg), f"'{checked.name}' is registered as {robot!r}, which is no RobotCfg."
    )
    require(robot.joints, "It has no joints. Name those of its file, in the order of every array of joints.")
    twice = [name for name in robot.joint_names if robot.joint_names.count(name) > 1]
    require(not twice, f"The joint '{twice[0] if twice else ''}' is named twice.")
    for joint in robot.joints:
        low, high = joint.range
        require(low < high, f"range of '{joint.name}' is {joint.range}: its low is not below its high.")
        require(
            low <= joint.default <= high,
            f"default of '{joint.name}' is {joint.default:g}, outside of its range {joint.range}.",
        )
        drives = joint.driven and joint.drive == "position"
        require(
            not drives or (joint.kp > 0.0 and joint.force_limit > 0.0),
            f"'{joint.name}' is driven by position and needs kp and force_limit above 0.",
        )
        leader = joint.follows[0] if joint.follows else joint.name
        require(leader in robot.joint_names, f"a joint follows '{leader}', which is none of its joints.")
    for joint, tied in zip(robot.joints, robot.with_home(robot.default_qpos).joints, strict=True):
        require(
            abs(tied.default - joint.default) < _TIED_RAD,
            f"default of '{joint.name}' is {joint.default:g}, and what it follows puts it at "
            f"{tied.default:g}.",
        )
    foreign = set(robot.gripper_joints) - set(robot.joint_names)
    require(not foreign, f"gripper_joints names {sorted(foreign)}, which are none of its joints.")
    return f"{counted(len(robot.joints), 'joint')}, {len(robot.driven)} driven"


@contract("joints")
def scene(checked: CheckedRobot) -> str:
    """The simulator makes it of its file: bodies, joints and the end effector are there."""
    checked.start()
    state = checked.handler.get_states().to("cpu").robots[checked.robot.name]
    require(state.ee_pos is not None, f"The end effector '{checked.robot.ee_site}' has no position.")
    x, y, z = state.ee_pos[0].tolist() if state.ee_pos is not None else (0.0, 0.0, 0.0)
    return f"{checked.simulator}, hand at ({x:.2f}, {y:.2f}, {z:.2f}) m"


@contract("scene")
def rests(checked: CheckedRobot) -> str:
    """It keeps its rest posture for 2 s; a free base comes to rest or falls, and all stays finite."""
    checked.start()
    state = checked.hold(checked.rest, _STAND_S)
    require(
        bool(torch.isfinite(state.joint_pos).all() and torch.isfinite(state.pos).all()),
        "The simulation became unstable at rest. Lower kp, or give joints damping and armature.",
    )
    if not checked.robot.fixed_base:
        return f"base at {float(state.pos[0, 2]):.2f} m"
    held = checked.positions
    off = (state.joint_pos[0] - torch.tensor(checked.robot.default_qpos))[held].abs()
    if not held:
        raise NotApplicableError("no joint is driven by position")
    worst = int(off.argmax())
    require(
        float(off[worst]) < _SAG_RAD,
        f"'{checked.robot.joint_names[held[worst]]}' moved by {float(off[worst]):.2f} rad (m) in "
        f"{_STAND_S:g} s while its targets were those of rest. Raise its kp or force_limit, or choose "
        "a rest in which no links touch.",
    )
    return f"off by at most {float(off[worst]):.3f} rad"


@contract("rests")
def follows(checked: CheckedRobot) -> str:
    """Each joint that is driven by position reaches its command, and the others stay."""
    robot, driven = checked.robot, list(checked.robot.driven)
    if not robot.fixed_base or not checked.positions:
        raise NotApplicableError("only joints of a fixed base that are driven by position have targets")
    worst = 0.0
    for index in checked.positions:
        joint = robot.joints[index]
        low, high = joint.range
        grips = joint.name in robot.gripper_joints
        size = _GRIPPER_SHARE * (high - low) if grips else min(_SHARE * (high - low), _MOST_RAD)
        towards = _inwards(size, joint.default, low, high)
        # At rest the ground, or the arm itself, may be in the way on one side.
        sides = [way for way in (towards, -towards) if low <= joint.default + way <= high]
        missed, way = min((_missed(checked, driven.index(index), index, way), way) for way in sides)
        worst = max(worst, missed)
        require(
            missed < min(_MISSED_RAD, 0.5 * abs(way)),
            f"'{joint.name}' had a target that differs by {way:+.2f} rad (m) and is {missed:.2f} off after "
            f"{_STEP_S:g} s. Check the order of joints, kp and force_limit, and whether something is in "
            "its way.",
        )
    return f"{counted(len(checked.positions), 'joint')}, off by at most {worst:.3f} rad"


@contract("rests")
def resets(checked: CheckedRobot) -> str:
    """A state that is set again leads to the same motion, bit by bit, whatever happened in between."""
    handler, robot = checked.handler, checked.robot
    if isinstance(handler, ModelHandler):
        require(
            handler.model.na == 0,
            "Its actuators have activations, which no state holds, so no reset would restore them. Let its "
            "joints be driven by position or torque.",
        )
    state = _moving(checked)
    first = _motion(checked, state)
    # In between, every joint has another speed and then goes to another target.
    _put(checked, replace(state, joint_vel=-2.0 * state.joint_vel, lin_vel=state.lin_vel + _SPEED))
    checked.hold(checked.rest, _DISTURBED_S)
    for step, (before, after) in enumerate(zip(first, _motion(checked, state), strict=True)):
        for name, value in before.items():
            different = (after[name] != value)[0].nonzero().flatten().tolist()
            which = _PARTS.get(name, robot.joint_names)
            where = f" of '{which[different[0]]}'" if different and len(which) > different[0] else ""
            require(
                not different,
                f"{name}{where} is another after {counted(step, 'step')} from the same state, which was set "
                "a second time after the robot had moved. What the simulator keeps beside the state must be "
                "set with it.",
            )
    passive = len(robot.joints) - len(robot.driven)
    return f"{counted(len(robot.joints), 'joint')}, {passive} passive, {_STEPS} control steps"


def _moving(checked: CheckedRobot) -> EntityState:
    """Returns a state on the way to other targets, in which joints have speeds; passive ones too."""
    checked.start()
    state = checked.hold(_elsewhere(checked), _DISTURBED_S)
    signs = torch.tensor([1.0, -1.0], dtype=state.joint_vel.dtype).repeat(len(checked.robot.joints))
    # What a simulator returns may read its arrays only when it is asked.
    values: dict[str, Any] = {field.name: getattr(state, field.name) for field in fields(EntityState)}
    values["joint_vel"] = state.joint_vel + _SPEED * signs[: len(checked.robot.joints)]
    return EntityState(**values)


def _elsewhere(checked: CheckedRobot) -> np.ndarray:
    """Returns targets of the driven joints within their ranges that are not those of rest, (D,)."""
    joints, target = checked.robot.joints, checked.rest.copy()
    for column, index in enumerate(checked.robot.driven):
        low, high = joints[index].target_range or joints[index].range
        target[column] += _inwards(min(_SHARE * (high - low), _MOST_RAD), target[column], low, high)
    return target


def _inwards(size: float, value: float, low: float, high: float) -> float:
    """Returns a way of this size with the sign that leads from a value to the middle of its range."""
    return size if value <= 0.5 * (low + high) else -size


def _put(checked: CheckedRobot, state: EntityState) -> None:
    checked.handler.set_states(State({checked.robot.name: state}, {}))


def _motion(checked: CheckedRobot, state: EntityState) -> list[dict[str, torch.Tensor]]:
    """Sets a state and steps; returns copies of all that moves, before the first step and after each."""
    _put(checked, state)
    seen = []
    for step in range(_STEPS + 1):
        if step:
            checked.handler.step(_PHYSICS.decimation)
        now = checked.handler.get_states().to("cpu").robots[checked.robot.name]
        names = ("pos", "rot", "lin_vel", "ang_vel", "joint_pos", "joint_vel")
        seen.append({name: getattr(now, name).clone() for name in names})
    return seen


def _missed(checked: CheckedRobot, column: int, index: int, way: float) -> float:
    """Returns how far a joint is from a target that is ``way`` from its rest, rad (m)."""
    target = checked.rest.copy()
    target[column] += way
    checked.start()
    state = checked.hold(target, _STEP_S)
    return abs(float(state.joint_pos[0, index]) - target[column])


@contract("rests")
def reaches(checked: CheckedRobot) -> str:
    """Inverse kinematics moves its hand by 5 cm along each axis, as an expert's waypoints need."""
    robot = checked.robot
    arm = [name for name in robot.joint_names if name not in robot.gripper_joints]
    if not robot.fixed_base or len(arm) < 6 or len(checked.positions) < 6:
        raise NotApplicableError("an arm with a hand has a fixed base and at least six joints")
    follower, worst = PathFollower(robot, _PHYSICS.control_hz), 0.0
    fingers = [joint.default for joint in robot.joints if joint.name in robot.gripper_joints]
    for direction in np.diag((-1.0, 1.0, 1.0)):  # back, to the left, and up
        checked.start()
        goal = _hand(checked) + _WAY_M * direction
        way = [Waypoint(pos=goal, yaw=0.0, gripper=max(fingers, default=0.0), duration_s=1.0, hold_s=0.5)]
        for target in follower.joint_targets(np.array(robot.default_qpos), way)[:, list(robot.driven)]:
            checked.hold(target, 1.0 / _PHYSICS.control_hz)
        worst = max(worst, float(np.linalg.norm(_hand(checked) - goal)))
    require(
        worst < _OFF_M,
        f"The hand is {100 * worst:.1f} cm from where it was sent. Choose a rest posture away from singular "
        "ones and from the edge of its reach, in which the hand points down.",
    )
    return f"off by at most {1000 * worst:.0f} mm"


def _hand(checked: CheckedRobot) -> np.ndarray:
    """Returns where the end effector is, (3,), m."""
    pos = checked.handler.get_states().to("cpu").robots[checked.robot.name].ee_pos
    assert pos is not None, "the contract of the scene has looked at it"
    return pos[0].numpy()


ROBOT_CONTRACTS: tuple[Contract[CheckedRobot], ...] = (joints, scene, rests, resets, follows, reaches)
