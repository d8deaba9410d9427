"""LIBERO's predicates as batched pure functions of states.

Formulas are those of its code (MIT): ``libero/envs/object_states/base_object_states.py``,
``objects/site_object.py``, ``objects/articulated_objects.py`` and ``objects/target_zones.py``. None asks
whether the gripper has let go or whether anything is at rest. Shapes: N states.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from envs.core.errors import SimulatorError, unknown_name
from envs.kinematics.object_parts import PartBox
from envs.rotations import to_matrix
from envs.state import State
from envs.tasks.libero.arenas import SURFACE_FIXTURES
from envs.tasks.libero.bddl import Atom, Region
from envs.tasks.libero.scene import LiberoScene

BELOW_M = 0.01
"""The lower face of a site's box is lowered by this (``SiteObject.in_box``)."""

NEAR_M = 0.03
"""Largest level distance of an object on another (``ObjectState.check_ontop``)."""

SINK_M, HEADROOM_M = 0.005, 0.10
"""How far an object on a site may be below the site's upper face, and above it (``SiteObject.under``)."""

ZONE_HALF_HEIGHT_M = 0.007
"""Half height of a region of a table (``TargetZone.zone_height``)."""


@dataclass(frozen=True, slots=True)
class JointRule:
    """When joints of a category count as open and shut, or as turned on and off.

    Attributes:
        on: Limit of open, or of turned on, rad (m).
        off: Limit of shut, or of turned off.
        rises: Whether a larger position is nearer to ``on``.
    """

    on: float
    off: float
    rises: bool = False


DRAWER = JointRule(on=-0.14, off=0.0)
MICROWAVE = JointRule(on=-1.3, off=-0.005)
STOVE = JointRule(on=0.5, off=0.0, rises=True)

JOINT_RULES = {
    "wooden_cabinet": DRAWER,
    "white_cabinet": DRAWER,
    "yellow_cabinet": DRAWER,
    "microwave": MICROWAVE,
    "flat_stove": STOVE,
    "yellow_stove": STOVE,
}
"""Category to the rule of its joints (``default_open_ranges`` and the like)."""


def in_site(pos: Tensor, site_pos: Tensor, site_rot: Tensor, half: Tensor) -> Tensor:
    """Returns whether a point is strictly inside a site's box along the world's axes, (N,).

    Args:
        pos: The point, (N, 3).
        site_pos: Middle of the site, (N, 3).
        site_rot: Its orientation, (N, 4).
        half: Its half sizes, (3,).
    """
    size = (to_matrix(site_rot) @ half).abs()
    low = site_pos - size
    low = torch.cat([low[:, :2], low[:, 2:] - BELOW_M], -1)
    return ((pos > low) & (pos < site_pos + size)).all(-1)


def over_site(pos: Tensor, site_pos: Tensor, site_rot: Tensor, half: Tensor) -> Tensor:
    """Returns whether a point is just over a site's upper face, (N,); arguments as of :func:`in_site`.

    LIBERO turns the way from the site by the site's rotation, not by its inverse.
    """
    way = (to_matrix(site_rot) @ (pos - site_pos)[..., None])[..., 0]
    high = (way[:, 2] > half[2] - SINK_M) & (way[:, 2] < half[2] + HEADROOM_M)
    return high & (way[:, :2].abs() < half[:2]).all(-1)


def over_object(pos: Tensor, other: Tensor) -> Tensor:
    """Returns whether a point is over another, at a level distance below 3 cm, (N,)."""
    return (other[:, 2] <= pos[:, 2]) & (torch.linalg.vector_norm(pos[:, :2] - other[:, :2], dim=-1) < NEAR_M)


def opened(joints: Tensor, rule: JointRule) -> Tensor:
    """Returns whether any of the joints (N, J) is open or turned on, (N,)."""
    return (joints >= rule.on if rule.rises else joints < rule.on).any(-1)


def shut(joints: Tensor, rule: JointRule) -> Tensor:
    """Returns whether all of the joints (N, J) are shut or turned off, (N,)."""
    return (joints < rule.off if rule.rises else joints > rule.off).all(-1)


class Goal:
    """A conjunction of atoms in one scene.

    Args:
        scene: The scene.
        atoms: What has to hold; the task's goal by default.
    """

    def __init__(self, scene: LiberoScene, atoms: tuple[Atom, ...] | None = None) -> None:
        self.atoms = scene.problem.goal if atoms is None else atoms
        self._scene = scene
        self._feels = {item.name: item.feels for item in scene.scenario.objects}
        for atom in self.atoms:
            self._check(atom)

    def _check(self, atom: Atom) -> None:
        """Raises a ConfigError, with file and line, for an atom that cannot be decided."""
        problem, parts = self._scene.problem, self._scene.parts
        for name in atom.args:
            region = problem.regions.get(name)
            if region is None:
                continue
            if region.target not in SURFACE_FIXTURES and region.target not in parts:
                raise problem.error(
                    name, f"the region '{name}' belongs to '{region.target}', which is not there"
                )
            if region.target in SURFACE_FIXTURES and region.ranges is None:
                raise problem.error(name, f"the region '{name}' of a table has no ':ranges'")
            if region.target in parts and region.site not in parts[region.target].sites:
                given = unknown_name(f"site of '{region.target}'", region.site, parts[region.target].sites)
                raise problem.error(name, str(given).rstrip("."))
        if atom.predicate not in ("in", "on"):
            owner = self._owner(atom.args[0])
            if self._scene.categories.get(owner) not in JOINT_RULES:
                what = self._scene.categories.get(owner, owner)
                raise problem.error(
                    "goal", f"nothing says when a '{what}' such as '{owner}' is {atom.predicate}"
                )

    def holds(self, atom: Atom, state: State) -> Tensor:
        """Returns whether an atom holds, (N,) bool.

        Raises:
            SimulatorError: It asks for a contact that the simulator does not report.
        """
        if atom.predicate in ("in", "on"):
            return self._placed(atom, state)
        joints, rule = self.joints(atom.args[0], state)
        is_open = atom.predicate in ("open", "turnon")
        return opened(joints, rule) if is_open else shut(joints, rule)

    def met(self, state: State) -> Tensor:
        """Returns which atoms hold, (N, A) bool."""
        return torch.stack([self.holds(atom, state) for atom in self.atoms], dim=-1)

    def joints(self, name: str, state: State) -> tuple[Tensor, JointRule]:
        """Returns the joints (N, J) that decide whether a fixture, or the part with a site, is open."""
        region, owner = self._scene.problem.regions.get(name), self._owner(name)
        joints = state.objects[owner].joint_pos
        if region is not None:
            parts = self._scene.parts[owner]
            joint = parts.parts[parts.site(region.site).part].joint
            assert joint is not None, "a region that opens is in a drawer"
            joints = joints[:, joint.column : joint.column + 1]
        return joints, JOINT_RULES[self._scene.categories[owner]]

    def _owner(self, name: str) -> str:
        region = self._scene.problem.regions.get(name)
        return name if region is None else region.target

    def site_pose(self, region: Region, state: State) -> tuple[Tensor, Tensor, Tensor]:
        """Returns position (N, 3), orientation (N, 4) and half sizes (3,) of a region's box."""
        like = next(iter(state.objects.values())).pos
        if region.target in SURFACE_FIXTURES:
            assert region.ranges is not None, "a region of a table has ranges"
            x, y, z = self._scene.arena.workspace
            x0, y0, x1, y1 = region.ranges
            middle = (x + region.middle[0], y + region.middle[1], z)
            half = ((x1 - x0) / 2, (y1 - y0) / 2, ZONE_HALF_HEIGHT_M)
            upright = like.new_tensor((1.0, 0.0, 0.0, 0.0)).expand(len(like), 4)
            return like.new_tensor(middle).expand(len(like), 3), upright, like.new_tensor(half)
        parts = self._scene.parts[region.target]
        site: PartBox = parts.site(region.site)
        return *parts.box_pose(state.objects[region.target], site), like.new_tensor(site.half)

    def _placed(self, atom: Atom, state: State) -> Tensor:
        thing, place = atom.args
        pos = state.objects[thing].pos
        region = self._scene.problem.regions.get(place)
        if region is None:
            return over_object(pos, state.objects[place].pos) & self.touches(thing, place, state)
        if atom.predicate == "in":
            return in_site(pos, *self.site_pose(region, state))
        over = over_site(pos, *self.site_pose(region, state))
        return over if region.target in SURFACE_FIXTURES else over & self.touches(thing, region.target, state)

    def touches(self, thing: str, other: str, state: State) -> Tensor:
        """Returns whether two objects touch, (N,) bool.

        Raises:
            SimulatorError: The simulator does not report contacts.
        """
        touched = state.objects[thing].touched
        if touched is None:
            raise SimulatorError(
                f"Whether '{thing}' is on '{other}' asks for their contact, which this simulator does not "
                "report. Take simulator=mujoco or simulator=mujoco_warp."
            )
        return touched[:, self._feels[thing].index(other)] > 0
