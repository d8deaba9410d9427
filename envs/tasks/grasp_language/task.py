"""Grasp the object that the instruction names, out of several on a table.

The sets are those of RoboVerse's language grasping (arXiv:2504.18904), whose objects it does not name. These
are LIBERO's groceries (arXiv:2306.03310), and LIBERO-PRO's recoloured ones in the set ``unseen``. The sets
``colours_1`` to ``colours_3`` are ours. All tasks of a set have one scene: what to grasp follows from the
instruction alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, override

import numpy as np

from envs.array_ops import Array, concatenate, norm, stack
from envs.kinematics.waypoints import Waypoint
from envs.rotations import multiply
from envs.scenario import CameraCfg, ObjectCfg, ScenarioCfg
from envs.state import State
from envs.tasks.arm_at_table import ArmAtTable, Start
from envs.tasks.grasp_language.catalogue import HORIZON, Entry, entries
from envs.tasks.grasp_language.scene import draw_places, objects_of
from envs.tasks.libero.scene import PHYSICS
from envs.tasks.skills.clouds import Heights, cloud
from envs.tasks.skills.grasps import top_grasps
from envs.tasks.skills.moves import Hand, pick
from envs.tasks.tabletop import FRONT_CAMERA, distance, ee_pos, grips_something, nearness

MIDDLE_M = (-0.06, 0.0)
"""Middle of where objects stand: within easy reach of the hand."""

LEAST_GAP_M = 0.008
"""Gap between the fingertips below which they hold nothing: the thinnest object is 24 mm thick."""

LOWEST_GRIP_M = 0.014
"""Least height of the grip site above the table."""

REACH_M = 0.12
"""Largest distance of the grip site from the origin of what it holds: bottles are held at their necks."""

MARGIN_M = 0.06
"""How much higher than success demands the expert lifts."""


@dataclass(frozen=True, kw_only=True)
class GraspByLanguage(ArmAtTable):
    """Lift the object that the instruction names, and nothing else.

    Success is that the named object is held ``lift_m`` above where it stood, and that no other is higher than
    ``others_m`` above its own place.

    Attributes:
        lift_m: Height above its start to which the named object is lifted, m.
        others_m: Height above its start at which another object counts as lifted too, m.
        spawn_half_size_m: Half widths of the rectangle in which objects stand, x and y, m.
        gap_m: Least gap between the circles round two objects, seen from above, m.
        yaw_range_rad: Objects are turned by up to this to either side from where their labels face the
            camera.
    """

    max_episode_steps: ClassVar[int] = HORIZON
    takes_arrays: ClassVar[bool] = True
    camera: ClassVar[CameraCfg] = replace(
        FRONT_CAMERA, pos=(0.95, 0.0, 0.95), look_at=(-0.1, 0.0, 0.1), fovy_deg=28.0
    )
    entry: ClassVar[Entry]

    lift_m: float = 0.1
    others_m: float = 0.03
    spawn_half_size_m: tuple[float, float] = (0.16, 0.3)
    gap_m: float = 0.02
    yaw_range_rad: float = 0.5

    @property
    @override
    def objects(self) -> tuple[ObjectCfg, ...]:
        return tuple(item.cfg for item in objects_of(self.entry.set).values())

    @property
    @override
    def scenario(self) -> ScenarioCfg:
        return replace(super().scenario, simulators=PHYSICS)

    @override
    def starts(self, rng: np.random.Generator) -> dict[str, Start]:
        items = objects_of(self.entry.set)
        radii = [item.radius_m for item in items.values()]
        places = np.array(MIDDLE_M) + draw_places(rng, radii, self.spawn_half_size_m, self.gap_m)
        yaws = rng.uniform(-self.yaw_range_rad, self.yaw_range_rad, len(items))
        return {
            name: Start((*place, item.height_m), yaw)
            for (name, item), place, yaw in zip(items.items(), places, yaws, strict=True)
        }

    @override
    def initial_state(self, rngs: Sequence[np.random.Generator]) -> State:
        state = super().initial_state(rngs)
        for name, item in objects_of(self.entry.set).items():
            entity = state.objects[name]
            entity.rot = multiply(entity.rot, entity.rot.new_tensor(item.cfg.rot).expand_as(entity.rot))
        return state

    @override
    def same_scene_tasks(self) -> tuple[str, ...]:
        others = (entry for entry in entries().values() if entry.target != self.entry.target)
        return tuple(entry.name for entry in others if entry.set == self.entry.set)

    @override
    def success(self, state: State) -> Array:
        lifted = self._lifted(state, self.entry.target) > self.lift_m
        others = stack([self._lifted(state, name) for name in self._others])
        return lifted & self._held(state) & (others < self.others_m).all(0)

    @override
    def reward(self, state: State) -> Array:
        """Returns a third each for a near hand, a closed one and the named object's height."""
        hand, target = ee_pos(self.arm(state)), state.objects[self.entry.target]
        near = nearness(distance(hand, target.pos))
        held = self._held(state)
        share = (self._lifted(state, self.entry.target) / self.lift_m).clip(0.0, 1.0)
        return 0.33 * (near + held + held * share)

    @override
    def observe(self, state: State) -> Array:
        """Returns the named object's pose, the way to it from the hand, and the others' places, (N, D)."""
        hand, target = ee_pos(self.arm(state)), state.objects[self.entry.target]
        others = [state.objects[name].pos for name in self._others]
        return concatenate((target.pos, target.rot, hand, target.pos - hand, *others))

    @override
    def expert(self, state: State, rng: np.random.Generator) -> list[Waypoint]:
        items, table = objects_of(self.entry.set), 0.0
        clouds = {name: cloud(item.parts, state.objects[name]) for name, item in items.items()}
        own = clouds[self.entry.target]
        others = np.concatenate([clouds[name] for name in self._others])
        lowest = float(own[:, 2].min()) + LOWEST_GRIP_M
        grasps = top_grasps(own, others, lowest, rng)
        if not grasps:
            return []
        pace = float(rng.uniform(0.9, 1.15))
        hand = Hand(ee_pos(self.arm(state))[0].numpy(), self.down_pitch_rad, pace)
        grasp = grasps[0]
        way = pick(hand, grasp, Heights(clouds.values(), table))
        up = grasp.pos + np.array([0.0, 0.0, self.lift_m + MARGIN_M])
        return [*way, replace(hand, pos=grasp.pos).to(up, grasp.yaw, 0.0, hold_s=0.2)]

    @property
    def _others(self) -> tuple[str, ...]:
        return tuple(name for name in objects_of(self.entry.set) if name != self.entry.target)

    def _lifted(self, state: State, name: str) -> Array:
        """Returns how far an object's origin is above where it stood, (N,), m."""
        return state.objects[name].pos[:, 2] - objects_of(self.entry.set)[name].height_m

    def _held(self, state: State) -> Array:
        """Returns whether the hand is at the named object and something keeps its fingers apart, (N,)."""
        robot, target = self.arm(state), state.objects[self.entry.target]
        near = norm(ee_pos(robot) - target.pos) < REACH_M
        return near & grips_something(robot, LEAST_GAP_M, self.robot)
