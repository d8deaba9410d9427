"""A task of an SO-101 with a small drawer: pull it open by its handle."""

from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np
from torch import Tensor

from envs.array_ops import concatenate, constant, within
from envs.kinematics.waypoints import Waypoint, miss
from envs.rotations import rotate
from envs.scenario import CameraCfg, GeomCfg, LinkCfg, ObjectCfg, ObjectJointCfg, Rgba
from envs.state import State
from envs.tasks.arm_at_table import Start, heading, travel_s
from envs.tasks.skills.from_above import slide
from envs.tasks.so101.scene import FRONT_CAMERA, OPEN_M, RISE_M, So101Task, beside, lifted, take
from envs.tasks.tabletop import distance, ee_pos, nearness

RANGE_M = 0.08
"""How far the drawer can be pulled out."""

POST_HALF_M = 0.006
"""Half the width of the handle's post."""

POST_M = (-0.045, 0.0, 0.0225)
"""Middle of the handle's post in the frame of a cabinet that is shut; its front is the plane x = 0."""

_GRIP_Z_M = 0.03
"""Height of the grip site when the fingers hold the post."""

_WOOD: Rgba = (0.55, 0.38, 0.22, 1.0)
_LIGHT: Rgba = (0.82, 0.7, 0.52, 1.0)
_METAL: Rgba = (0.15, 0.25, 0.6, 1.0)


def cabinet() -> ObjectCfg:
    """Returns a cabinet, 14 cm wide and 5 cm high, that opens along its -x axis."""
    sides = (
        # half size, middle
        ((0.06, 0.07, 0.003), (0.06, 0.0, 0.047)),
        ((0.06, 0.003, 0.022), (0.06, 0.067, 0.022)),
        ((0.06, 0.003, 0.022), (0.06, -0.067, 0.022)),
        ((0.003, 0.064, 0.022), (0.117, 0.0, 0.022)),
    )
    body = tuple(GeomCfg(shape="box", size=size, pos=pos, rgba=_WOOD) for size, pos in sides)
    moving = (
        # half size, middle, colour, mass in kg: front, floor, stem and post
        ((0.003, 0.06, 0.019), (0.003, 0.0, 0.021), _LIGHT, 0.03),
        ((0.05, 0.06, 0.002), (0.055, 0.0, 0.004), _LIGHT, 0.05),
        ((0.0225, 0.004, 0.004), (-0.0225, 0.0, 0.008), _METAL, 0.005),
        ((POST_HALF_M, POST_HALF_M, 0.0185), POST_M, _METAL, 0.01),
    )
    parts = tuple(
        GeomCfg(shape="box", size=size, pos=pos, rgba=rgba, mass_kg=mass) for size, pos, rgba, mass in moving
    )
    slide = ObjectJointCfg(
        kind="slide", axis=(-1.0, 0.0, 0.0), range=(0.0, RANGE_M), damping=1.0, frictionloss=0.2
    )
    drawer = LinkCfg(name="drawer", geoms=parts, joint=slide)
    return ObjectCfg(name="cabinet", geoms=body, links=(drawer,), pos=(0.28, 0.0, 0.0), kind="fixed")


@dataclass(frozen=True, kw_only=True)
class OpenDrawer(So101Task):
    """Pull the drawer open by its handle.

    Attributes:
        open_m: How far it is out when it is open.
    """

    name: ClassVar[str] = "so101/open_drawer"
    instructions: ClassVar[tuple[str, ...]] = (
        "open the drawer",
        "pull the drawer open by its handle",
        "grasp the handle and pull the drawer out",
    )
    max_episode_steps: ClassVar[int] = 240
    camera: ClassVar[CameraCfg] = replace(FRONT_CAMERA, pos=(0.418, 0.412, 0.275), look_at=(0.2, 0.0, 0.05))
    """From the side, at az+060-pol60: from ahead the cabinet hides its drawer."""

    open_m: float = 0.045

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return (cabinet(),)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        side, turn = rng.uniform(-0.3, 0.3), rng.uniform(-0.15, 0.15)
        far = rng.uniform(0.27, 0.285)
        return {"cabinet": Start((far * np.cos(side), far * np.sin(side), 0.0), side + turn, (0.0,))}

    @override
    def success(self, state: State) -> Tensor:
        return state.objects["cabinet"].joint_pos[:, 0] >= self.open_m

    @override
    def reward(self, state: State) -> Tensor:
        """Returns the mean of being near the handle and of how far the drawer is out, (N,)."""
        opened = within(state.objects["cabinet"].joint_pos[:, 0] / self.open_m, 0.0, 1.0)
        return 0.3 * nearness(distance(ee_pos(self.arm(state)), self._handle(state))) + 0.6 * opened

    @override
    def observe(self, state: State) -> Tensor:
        """Returns the handle, the hand, the way between them, the cabinet's turn and its opening, (N, 14)."""
        hand, handle, item = ee_pos(self.arm(state)), self._handle(state), state.objects["cabinet"]
        return concatenate((handle, hand, handle - hand, item.rot, item.joint_pos))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        facing = heading(state.objects["cabinet"])
        yaw = facing + np.pi / 2  # the fingers close across the pull
        middle = self._handle(state)[0].numpy().copy()
        middle[2] = _GRIP_Z_M
        left = self.open_m + 0.012 - float(state.objects["cabinet"].joint_pos[0, 0])
        pull = -max(left, 0.0) * np.array([np.cos(facing), np.sin(facing), 0.0])
        hand = ee_pos(self.arm(state))[0].numpy()
        spread = miss(rng, often_m=0.005, seldom_m=0.012)
        above = lifted(middle + np.array([*rng.normal(0.0, spread, 2), 0.0]), rng.uniform(0.068, 0.076))
        come = Waypoint(pos=above, yaw=yaw, gripper=OPEN_M, duration_s=travel_s(hand, above, 0.7))
        ways = take(come, beside(middle, POST_HALF_M, yaw), yaw)
        held, pull_s = ways[-1], 0.3 + 12.0 * float(np.linalg.norm(pull))
        return [*self.rise(state, RISE_M), *ways, *slide(held, (held.pos + pull,), (pull_s,), hold_s=0.3)]

    def _handle(self, state: State) -> Tensor:
        """Returns the middle of the handle's post in the world, (N, 3), m."""
        item = state.objects["cabinet"]
        shut = constant(POST_M, item.pos)
        out = item.joint_pos * constant((-1.0, 0.0, 0.0), item.pos)
        return item.pos + rotate(item.rot, shut + out)
