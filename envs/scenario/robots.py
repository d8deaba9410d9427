"""Robots, as frozen data."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from envs.core.errors import ConfigError
from envs.scenario.objects import GeomCfg
from envs.scenario.units import IDENTITY, AssetRef, Quat, Vec3


@dataclass(frozen=True, kw_only=True, slots=True)
class ReadingCfg:
    """How datasets and policies read a joint, where that is not its position in rad (m).

    The number is ``scale * (position - zero)``. :mod:`envs.joint_readings` alone converts.

    Attributes:
        name: Name of the number in datasets.
        scale: Units per rad (m); not 0.
        zero: Position at which the number is 0, rad (m).
    """

    name: str
    scale: float
    zero: float = 0.0

    def __post_init__(self) -> None:
        if not self.scale:
            raise ConfigError(
                f"The reading '{self.name}' has a scale of 0, so it would always read the same."
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class JointCfg:
    """One joint of a robot: its name in the robot's file, its actuator and where it rests.

    Attributes:
        name: Joint name in the robot's MJCF.
        kp: Position gain, N·m/rad (N/m for a slide joint).
        kd: Damping gain, N·m·s/rad (N·s/m).
        force_limit: Largest actuator force, N·m (N).
        range: Position limits, rad (m).
        default: Rest position, rad (m).
        flip: The file's axis is turned round, so that the joint's positive direction is ours.
        damping: Passive damping that replaces the file's, or None to keep it.
        armature: Rotor inertia that replaces the file's, or None to keep it.
        frictionloss: Dry friction that replaces the file's, or None to keep it.
        driven: Whether it has an actuator; one that has none is part of the state alone.
        target_range: Limits of the actuator's target, if they are not the joint's; rad (m).
        drive: What a target is: a ``position``, or a ``torque`` in N·m (a force in N), which needs no ``kp``
            and a ``target_range``. A torque's rest is 0.
        reading: How datasets and policies read it; None is its position, rad (m), by its name.
        follows: A driven joint and a ratio: this one is tied to the ratio times the other's position, as bars
            of a closed loop are. It is not driven itself.
        pulls: Further joints, not driven themselves, with a coefficient each: the actuator pulls one tendon
            over all of them. A target, in ``target_range``, is its length: this joint's position and each
            coefficient times that of the other, rad (m). kp, kd and force_limit are of this length; each
            joint feels its coefficient times the force, this one all of it.
    """

    name: str
    kp: float
    kd: float
    force_limit: float
    range: tuple[float, float]
    default: float
    flip: bool = False
    damping: float | None = None
    armature: float | None = None
    frictionloss: float | None = None
    driven: bool = True
    target_range: tuple[float, float] | None = None
    drive: Literal["position", "torque"] = "position"
    reading: ReadingCfg | None = None
    follows: tuple[str, float] | None = None
    pulls: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if self.follows is not None and self.driven:
            raise ConfigError(f"Joint '{self.name}' follows '{self.follows[0]}', so it needs driven=False.")
        if self.drive == "torque" and (self.target_range is None or self.kp):
            raise ConfigError(
                f"Joint '{self.name}' is driven by a torque, so it needs a target_range (N·m) and kp=0."
            )
        if self.pulls and (not self.driven or self.target_range is None):
            raise ConfigError(
                f"Joint '{self.name}' pulls a tendon over {', '.join(name for name, _ in self.pulls)} too, "
                "so it needs an actuator (driven=True) and a target_range of the tendon's length, rad (m)."
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class BodyCfg:
    """Properties of a robot's body that replace its file's.

    Attributes:
        name: Body of the robot's file.
        mass_kg: Mass.
        com: Centre of mass in the body, m.
        inertia: Principal moments of inertia, kg·m².
        inertia_rot: Orientation of the principal axes in the body, wxyz.
        hull: Corners, in the body, of a convex shape that is touched instead of the file's shapes; none
            keeps those.
    """

    name: str
    mass_kg: float
    com: Vec3
    inertia: Vec3
    inertia_rot: Quat
    hull: tuple[Vec3, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class SiteCfg:
    """A named place on a robot.

    Attributes:
        name: Its name.
        body: Body that carries it.
        pos: Position in the body, m.
    """

    name: str
    body: str
    pos: Vec3


@dataclass(frozen=True, kw_only=True, slots=True)
class GripperCfg:
    """A gripper that any arm with a ``gripper_mount`` takes; see :meth:`RobotCfg.with_gripper`.

    Names of its joints and of its site begin with ``gripper/``. Its site's fingers open along x, and z points
    forward.

    Attributes:
        mjcf: Asset reference of its file.
        root: Body of the file that is attached.
        ee_site: Site between the fingertips.
        joints: Its joints; one that is not driven comes after those that are.
        gripper_joints: Names of those that a command opens and closes.
        range: Closed and open position of each of them; see :class:`RobotCfg`.
        opening_m: Distance between the fingertips when open, m; see :class:`RobotCfg`.
        closed_m: Distance between the fingertips when closed, m.
    """

    mjcf: AssetRef
    root: str
    ee_site: str
    joints: tuple[JointCfg, ...]
    gripper_joints: tuple[str, ...]
    range: tuple[tuple[float, float], ...] = ()
    opening_m: float | None = None
    closed_m: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class RobotCfg:
    """A robot: one MJCF file, an optional gripper attached to it, and its joints in our order.

    Attributes:
        name: Prefix of everything the robot brings into the scene.
        mjcf: Asset reference, ``"package:path/inside/package.xml"``.
        root: Body of ``mjcf`` that is attached to the world.
        gripper_mjcf: Asset reference of the gripper, or None.
        gripper_root: Body of the gripper's file that is attached.
        gripper_mount: Body of the robot that carries the gripper or the tool.
        tool: Shapes that ``gripper_mount`` carries instead of a gripper, in its frame: the body ``tool``.
        joints: Its joints; this order is the order of every array of joints.
        ee_site: Site, or body, that is called the end effector.
        gripper_joints: Names of the joints, of ``joints``, that open and close the gripper.
        gripper_range: Closed and open position of each of ``gripper_joints``; empty takes the ends of their
            ranges, the lower one closed.
        gripper_opening_m: Distance between the fingertips when open, m; None is the sum of the strokes of
            fingers that slide.
        gripper_closed_m: Distance between the fingertips when closed, m.
        camera_mount: Body that carries the wrist camera; None is ``gripper_mount``.
        hollow_meshes: Whether the file's meshes are surfaces without a volume, which MuJoCo refuses unless
            this is set; masses are the file's all the same.
        apart: Pairs of bodies of the file that never touch each other. MuJoCo tests a bolted base against its
            first link, unlike other neighbours.
        bodies: What replaces masses and shapes of the file.
        sites: Places that the file lacks.
        pos: Base position in the world, m; of a free base at rest.
        rot: Base orientation in the world, wxyz; likewise.
        fixed_base: Whether the base is bolted down. If not it moves freely, and its pose and velocity are
            part of the state.
        gravity_compensated: Gravity does not act on the robot's own links.
        feels: Robots, objects, or ``"ground"``, whose touch is part of its state.
        lerobot_type: ``robot_type`` of its datasets: the robot of LeRobot's with the same joints in the same
            units; empty is ``name``.
    """

    name: str
    mjcf: AssetRef
    root: str
    joints: tuple[JointCfg, ...]
    ee_site: str
    gripper_mjcf: AssetRef | None = None
    gripper_root: str | None = None
    gripper_mount: str | None = None
    tool: tuple[GeomCfg, ...] = ()
    gripper_joints: tuple[str, ...] = ()
    gripper_range: tuple[tuple[float, float], ...] = ()
    gripper_opening_m: float | None = None
    gripper_closed_m: float = 0.0
    camera_mount: str | None = None
    hollow_meshes: bool = False
    apart: tuple[tuple[str, str], ...] = ()
    bodies: tuple[BodyCfg, ...] = ()
    sites: tuple[SiteCfg, ...] = ()
    pos: Vec3 = (0.0, 0.0, 0.0)
    rot: Quat = IDENTITY
    fixed_base: bool = True
    gravity_compensated: bool = True
    feels: tuple[str, ...] = ()
    lerobot_type: str = ""

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(joint.name for joint in self.joints)

    @property
    def reading_names(self) -> tuple[str, ...]:
        """Names of the joints' readings, in order, as datasets have them."""
        return tuple(joint.name if joint.reading is None else joint.reading.name for joint in self.joints)

    @property
    def driven(self) -> tuple[int, ...]:
        """Indices, among the joints, of those that have an actuator: the order of joint targets."""
        return tuple(index for index, joint in enumerate(self.joints) if joint.driven)

    @property
    def arm(self) -> tuple[int, ...]:
        """Indices, among the joints, of those that have an actuator and are no gripper's."""
        return tuple(index for index in self.driven if self.joints[index].name not in self.gripper_joints)

    @property
    def fingers(self) -> tuple[int, ...]:
        """Indices, among the joints, of the gripper's."""
        return tuple(self.joint_names.index(name) for name in self.gripper_joints)

    @property
    def finger_limits(self) -> tuple[tuple[float, float], ...]:
        """Closed and open position of each of the gripper's joints."""
        return self.gripper_range or tuple(self.joints[index].range for index in self.fingers)

    @property
    def opening_m(self) -> float:
        """Distance between the fingertips when the gripper is open, m."""
        if self.gripper_opening_m is not None:
            return self.gripper_opening_m
        return sum(abs(wide - shut) for shut, wide in self.finger_limits)

    @property
    def default_qpos(self) -> tuple[float, ...]:
        """Rest position of every joint, in order."""
        return tuple(joint.default for joint in self.joints)

    def finger_positions(self, half_gap_m: Any) -> Any:
        """Returns positions (..., F) of the F gripper's joints for fingertips that far from the middle.

        Args:
            half_gap_m: Half the distance between the fingertips, m, (...); what is wider than the gripper
                opens is its opening, and what is narrower than it closes is its closed position.
        """
        if not self.gripper_joints:
            return np.zeros((*np.shape(half_gap_m), 0))
        stroke = self.opening_m - self.gripper_closed_m
        share = np.clip((2.0 * np.asarray(half_gap_m) - self.gripper_closed_m) / stroke, 0.0, 1.0)[..., None]
        shut, wide = np.array(self.finger_limits).T
        return shut + share * (wide - shut)

    def with_home(self, qpos: Sequence[float]) -> "RobotCfg":
        """Returns this robot with other rest positions, one per joint.

        A joint that follows another one rests where that one's position puts it.
        """
        at = dict(zip(self.joint_names, qpos, strict=True))
        for joint in self.joints:
            if joint.follows is not None:
                at[joint.name] = joint.follows[1] * at[joint.follows[0]]
        return replace(self, joints=tuple(replace(joint, default=at[joint.name]) for joint in self.joints))

    def with_gripper(self, gripper: GripperCfg, name: str) -> "RobotCfg":
        """Returns this arm, called ``name``, with a gripper in place of the one that it has, if any."""
        return replace(
            self,
            name=name,
            joints=(*(self.joints[index] for index in self.arm), *gripper.joints),
            gripper_mjcf=gripper.mjcf,
            gripper_root=gripper.root,
            ee_site=gripper.ee_site,
            gripper_joints=gripper.gripper_joints,
            gripper_range=gripper.range,
            gripper_opening_m=gripper.opening_m,
            gripper_closed_m=gripper.closed_m,
        )
