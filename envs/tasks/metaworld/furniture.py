"""DrawerOpen, DrawerClose, DoorClose, WindowOpen and WindowClose, written as functions of batched states.

Formulas and constants are Meta-World's (``envs/sawyer_drawer_open_v3.py`` and its like, MIT, rewards of
version 2); :mod:`tests.envs.tasks.metaworld` compares them with its own code. They need no simulation and
run on any device, so many environments cost little more than one.
"""

import math
from abc import abstractmethod
from typing import ClassVar, override

import torch
from torch import Tensor

from envs.robots.sawyer import SAWYER, SAWYER_FINGERS
from envs.rotations import multiply, rotate
from envs.state import State
from envs.tasks.metaworld.scene import GOAL
from envs.tasks.metaworld.task import BELOW_ONE, MAX_REWARD, MetaWorldTask
from envs.tasks.tabletop import distance, ee_pos

FINGERTIP_M = 0.045
"""Distance of the fingertips from the hand, along its x axis (``xyz_base.xml``, ``rightEndEffector``)."""

OPEN_M = 0.1
"""Distance of the claws when both finger joints are at 0; Meta-World's unit of the gripper's opening."""

HAND_LOW_M, HAND_HIGH_M = (-0.525, 0.348, -0.0525), (0.525, 1.025, 0.7)
"""Bounds of the observed hand (``sawyer_xyz_env.py``, ``_HAND_SPACE``)."""

NO_ORIENTATION = (0.0, 0.0, 0.0, 0.0)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)

_VALUE_AT_MARGIN = 0.1
_R_CLOSE, _L_CLOSE = (SAWYER.joint_names.index(name) for name in SAWYER_FINGERS)


def beyond(distance_m: Tensor, bound_m: float, margin_m: float | Tensor) -> Tensor:
    """Returns how far a distance is beyond a bound, in margins: 0 within the bound, 1 at the margin."""
    return ((distance_m - bound_m) / margin_m).clamp(min=0.0)


def long_tail(margins: Tensor) -> Tensor:
    """Returns dm_control's sigmoid ``long_tail``: 1 at 0, 0.1 at 1."""
    return 1.0 / (1.0 + (1.0 / _VALUE_AT_MARGIN - 1.0) * margins**2)


def gaussian(margins: Tensor) -> Tensor:
    """Returns dm_control's sigmoid ``gaussian``: 1 at 0, 0.1 at 1."""
    return torch.exp(math.log(_VALUE_AT_MARGIN) * margins**2)


def both(a: Tensor, b: Tensor) -> Tensor:
    """Returns the Hamacher product of numbers in [0, 1]: near 1 only if both are."""
    total = a + b - a * b
    return torch.where(total > 0.0, a * b / total.clamp(min=1e-30), 0.0)


class FurnitureTask(MetaWorldTask):
    """One piece of furniture whose handle has to reach the goal.

    Attributes:
        furniture: The object that carries the joint.
        start_tcp: Where the fingertips are at the start, m: where Meta-World's reset leaves them.
        tolerance_m: Largest way left that is a success.
    """

    furniture: ClassVar[str]
    tolerance_m: ClassVar[float]
    start_tcp: ClassVar[tuple[float, float, float]]

    @abstractmethod
    def handle(self, state: State) -> Tensor:
        """Returns the handle's position as Meta-World observes it, m, (N, 3)."""

    @abstractmethod
    def way_left(self, state: State) -> Tensor:
        """Returns how far the handle is from the goal, m, (N,)."""

    def orientation(self, state: State) -> Tensor:
        """Returns the handle's orientation as Meta-World observes it, (N, 4); zeros where it does not."""
        return ee_pos(state.robots[SAWYER.name]).new_tensor(NO_ORIENTATION).expand(state.num_envs, 4)

    @override
    def success(self, state: State) -> Tensor:
        return self.way_left(state) <= self.tolerance_m

    @override
    def observe(self, state: State) -> Tensor:
        hand = self.hand(state)
        opening = (OPEN_M + self.finger(state, _L_CLOSE) - self.finger(state, _R_CLOSE)).abs() / OPEN_M
        parts = (hand, opening.clamp(max=1.0)[:, None], self.handle(state), self.orientation(state))
        return torch.cat((*parts, hand.new_zeros((len(hand), 7)), state.objects[GOAL].pos), dim=-1)

    def finger(self, state: State, index: int) -> Tensor:
        """Returns the position of one finger's joint, m, (N,)."""
        return state.robots[SAWYER.name].joint_pos[:, index]

    def hand(self, state: State) -> Tensor:
        """Returns the hand's position within the bounds of its observation, m, (N, 3)."""
        pos = ee_pos(state.robots[SAWYER.name])
        return torch.minimum(torch.maximum(pos, pos.new_tensor(HAND_LOW_M)), pos.new_tensor(HAND_HIGH_M))

    def tcp(self, state: State) -> Tensor:
        """Returns the middle between the fingertips, m, (N, 3)."""
        robot = state.robots[SAWYER.name]
        assert robot.ee_rot is not None, "a simulator gives every robot's end effector"
        middle = 0.5 * (self.finger(state, _R_CLOSE) + self.finger(state, _L_CLOSE))
        local = torch.stack((torch.full_like(middle, FINGERTIP_M), middle, torch.zeros_like(middle)), -1)
        return ee_pos(robot) + rotate(robot.ee_rot, local)

    def root(self, state: State) -> Tensor:
        """Returns the position of the furniture, m, (N, 3)."""
        return state.objects[self.furniture].pos

    def joint(self, state: State) -> Tensor:
        """Returns how far it is open or shut, m or rad, (N,)."""
        return state.objects[self.furniture].joint_pos[:, 0]

    def along(self, state: State, offset: tuple[float, float, float], axis: int) -> Tensor:
        """Returns a point of a sliding part, m, (N, 3): ``offset`` from the root, moved along an axis."""
        point = self.root(state) + self.root(state).new_tensor(offset)
        point[:, axis] += self.joint(state)
        return point

    def start(self, state: State) -> Tensor:
        """Returns where the fingertips began, m, (3,)."""
        return self.root(state).new_tensor(self.start_tcp)


def _paid(reward: Tensor) -> Tensor:
    return (reward / MAX_REWARD).clamp(0.0, BELOW_ONE)


class DrawerOpen(FurnitureTask):
    """Pull the drawer out by 20 cm."""

    name = "DrawerOpen"
    instructions = (
        "open the drawer",
        "pull the drawer out by its handle",
        "reach for the drawer's handle and pull it open",
    )
    original_name = "drawer-open-v3"
    furniture = "drawer"
    start_tcp = (0.004410529911, 0.601499946892, 0.150157951998)
    tolerance_m = 0.03

    open_way_m = 0.2
    handle_offset = (0.0, -0.17, 0.09)
    """Of the closed drawer's handle (``drawer.xml``: links at 0.084 and (-0.01, 0.006); handle at -0.16)."""

    @override
    def handle(self, state: State) -> Tensor:
        return self.along(state, self.handle_offset, axis=1)

    @override
    def way_left(self, state: State) -> Tensor:
        return distance(self.handle(state), state.objects[GOAL].pos)

    @override
    def orientation(self, state: State) -> Tensor:
        return self.root(state).new_tensor(UPRIGHT).expand(state.num_envs, 4)

    @override
    def reward(self, state: State) -> Tensor:
        opened = long_tail(beyond(self.way_left(state), 0.02, self.open_way_m))
        goal = state.objects[GOAL].pos
        # Errors along x and y count more, so that the hand approaches from above.
        scale = goal.new_tensor((3.0, 3.0, 1.0))
        first = goal + goal.new_tensor((0.0, self.open_way_m, 0.0)) - self.start(state)
        margin = torch.linalg.vector_norm(first * scale, dim=-1)
        reach = torch.linalg.vector_norm((self.handle(state) - self.hand(state)) * scale, dim=-1)
        return _paid(5.0 * (long_tail(beyond(reach, 0.01, margin)) + opened))


class DrawerClose(FurnitureTask):
    """Push the open drawer in.

    Meta-World's reward multiplies nearness to the handle by progress, so its own scripted policy, which
    pushes beside the handle, ends with a lower reward than it starts with. Therefore half of our reward is
    Meta-World's, and half is progress.
    """

    name = "DrawerClose"
    instructions = (
        "close the drawer",
        "push the drawer in",
        "push against the open drawer until it is closed",
    )
    original_name = "drawer-close-v3"
    furniture = "drawer"
    start_tcp = DrawerOpen.start_tcp
    tolerance_m = 0.065

    radius_m = 0.05
    handle_offset = (0.0, -0.17, 0.14)
    start_way_m = 0.15

    @override
    def handle(self, state: State) -> Tensor:
        return self.along(state, self.handle_offset, axis=1)

    @override
    def way_left(self, state: State) -> Tensor:
        return distance(self.handle(state), state.objects[GOAL].pos)

    @override
    def reward(self, state: State) -> Tensor:
        offset = self.root(state).new_tensor(self.handle_offset)
        offset[1] -= self.start_way_m
        first = self.root(state) + offset
        margin = (distance(first, state.objects[GOAL].pos) - self.radius_m).abs()
        in_place = long_tail(beyond(self.way_left(state), self.radius_m, margin))
        to_handle = (distance(first, self.start(state)) - 0.005).abs()
        reach = gaussian(beyond(distance(self.handle(state), self.tcp(state)), 0.005, to_handle))
        target = state.robots[SAWYER.name].joint_target
        assert target is not None, "a simulator gives every robot's targets"
        return _paid(5.0 * (both(both(reach, target[:, 0].clamp(0.0, 1.0)), in_place) + in_place))


class DoorClose(FurnitureTask):
    """Push the open door of a safe shut."""

    name = "DoorClose"
    instructions = (
        "close the door",
        "push the door shut",
        "swing the open door of the safe back until it is closed",
    )
    original_name = "door-close-v3"
    furniture = "door"
    start_tcp = (-0.499356520102, 0.605408480079, 0.150211291325)
    tolerance_m = 0.08

    hinge = (-0.185, -0.1, 0.0)
    handle_offset = (0.3757216291725, -0.1071398959155, 3.594871036353e-05)
    """From the hinge to the handle's mesh, as MuJoCo centres it (``doorlockB.xml``, ``door_handle.stl``)."""
    handle_rot = (0.151171070206, 0.6907585016, -0.150620952829, 0.690878664144)
    start_hand = (-0.5, 0.6, 0.2)
    radius_m = 0.05

    @override
    def handle(self, state: State) -> Tensor:
        root = self.root(state)
        arm = rotate(self._turn(state), root.new_tensor(self.handle_offset).expand(len(root), 3))
        return root + root.new_tensor(self.hinge) + arm

    @override
    def way_left(self, state: State) -> Tensor:
        return distance(self.handle(state), state.objects[GOAL].pos)

    @override
    def orientation(self, state: State) -> Tensor:
        """Returns the orientation of the handle's mesh, (x, y, z, w), its largest part positive."""
        turn = self._turn(state)
        quat = multiply(turn, turn.new_tensor(self.handle_rot).expand_as(turn))
        largest = quat.gather(1, quat.abs().argmax(dim=1, keepdim=True))
        return (quat * torch.sign(largest))[:, [1, 2, 3, 0]]

    @override
    def reward(self, state: State) -> Tensor:
        goal, handle = state.objects[GOAL].pos, self.handle(state)
        margin = distance(self.root(state), goal)
        in_place = gaussian(beyond(self.way_left(state), self.radius_m, margin))
        to_handle = distance(goal.new_tensor(self.start_hand), handle) + 0.1
        reach = gaussian(beyond(distance(self.tcp(state), goal), 0.25 * self.radius_m, to_handle))
        return _paid(3.0 * reach + 6.0 * in_place)

    def _turn(self, state: State) -> Tensor:
        half = 0.5 * self.joint(state)
        zero = torch.zeros_like(half)
        return torch.stack((torch.cos(half), zero, zero, torch.sin(half)), dim=-1)


class WindowOpen(FurnitureTask):
    """Slide the window open, to the right."""

    name = "WindowOpen"
    instructions = (
        "open the window",
        "slide the window open",
        "push the window's handle to the right until it is open",
    )
    original_name = "window-open-v3"
    furniture = "window"
    start_tcp = (0.004673567335, 0.400202403467, 0.150729583598)
    tolerance_m = 0.05

    handle_offset = (-0.04, -0.095, 0.0)
    """Of the handle's side that is pushed, when the window is shut (``window_horiz.xml``)."""
    start_slide_m = 0.0
    margin_m = 0.15
    handle_radius_m = 0.02

    @override
    def handle(self, state: State) -> Tensor:
        return self.along(state, self.handle_offset, axis=0)

    @override
    def way_left(self, state: State) -> Tensor:
        return (self.handle(state)[:, 0] - state.objects[GOAL].pos[:, 0]).abs()

    @override
    def reward(self, state: State) -> Tensor:
        in_place = long_tail(beyond(self.way_left(state), self.tolerance_m, self.margin_m))
        return _paid(10.0 * both(self.near(self._reach(state)), in_place))

    def near(self, margins: Tensor) -> Tensor:
        """Returns the reward of being near the handle."""
        return long_tail(margins)

    def _reach(self, state: State) -> Tensor:
        offset = self.root(state).new_tensor(self.handle_offset)
        offset[0] += self.start_slide_m
        margin = distance(self.root(state) + offset, self.start(state)) - self.handle_radius_m
        return beyond(distance(self.handle(state), self.tcp(state)), self.handle_radius_m, margin.abs())


class WindowClose(WindowOpen):
    """Slide the open window shut, to the left."""

    name = "WindowClose"
    instructions = (
        "close the window",
        "slide the window shut",
        "push the window's handle to the left until it is closed",
    )
    original_name = "window-close-v3"

    handle_offset = (0.01, -0.095, 0.0)
    start_slide_m = 0.2
    margin_m = 0.16

    @override
    def near(self, margins: Tensor) -> Tensor:
        return gaussian(margins)
