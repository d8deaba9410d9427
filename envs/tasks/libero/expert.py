"""LIBERO's expert: a plan of skills made from the goal of the task file.

Of the goal's atoms that do not hold, one is worked on at a time: drawers are opened first, then things are
put where they belong, then what has to be shut is shut, and knobs are turned. What it does follows from what
it sees, so that few demonstrations can teach it: a choice by chance is in no image. Where an atom fails, the
expert is asked again; after so many times that something must have failed, chance chooses among the grasps.
A task needs no code of its own.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

from envs.kinematics.waypoints import Waypoint
from envs.rotations import to_matrix
from envs.state import State
from envs.tasks.libero.arenas import SURFACE_FIXTURES
from envs.tasks.libero.bddl import Atom
from envs.tasks.libero.goals import JOINT_RULES, STOVE, Goal, in_site, over_object, over_site
from envs.tasks.libero.scene import LiberoScene
from envs.tasks.skills.clouds import Heights, Underside, cloud
from envs.tasks.skills.grasps import Grasp, top_grasps
from envs.tasks.skills.hands import FINGER_MOST_M, hand_underside
from envs.tasks.skills.joints import push_door, slide_part, turn_knob
from envs.tasks.skills.moves import RELEASE_M, Hand, drag, pick, put
from envs.tasks.tabletop import ee_pos

HOME_TILT_RAD = -0.0568
"""Pitch that makes the fingers point straight down: in LIBERO's home posture they lean by that much."""

LOWEST_GRIP_M = 0.014
"""Least height of the grip site over what carries an object."""

PACE = 1.0
"""Speed of the hand, as a share of that of the skills."""

GRASPS_TRIED = 24
"""Of the best grasps, how many are combined with places."""

TURNS = (0.0, np.pi / 2, -np.pi / 2)
"""Turns of an object between its grasp and its place."""

OPEN_ENOUGH_M = -0.1
"""Joint position beyond which things can be put into a drawer."""

OPENED_M, SHUT_M = -0.156, 0.012
"""Where drawers are pulled and pushed to; beyond the ends of their ways."""

DOOR_SHUT_RAD = 0.03
"""Where a door is pushed to, a little beyond shut."""

FLAT_M = 0.04
"""Height of what is dragged over the table when it cannot be grasped, at most."""

KNOB_ON_RAD, KNOB_OFF_RAD = 0.9, -0.25


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What the expert sees: one state, as points."""

    scene: LiberoScene
    goal: Goal
    state: State
    hand: Hand
    clouds: dict[str, np.ndarray]

    def heights(self, without: str | None = None) -> Heights:
        others = [points for name, points in self.clouds.items() if name != without]
        x, y, _ = self.scene.arena.workspace
        return Heights(others, self.scene.arena.top_z_m, (x - 0.8, y - 0.9), (x + 0.8, y + 0.9))

    def others(self, name: str) -> np.ndarray:
        return np.concatenate([points for other, points in self.clouds.items() if other != name])


def plan(
    scene: LiberoScene, goal: Goal, state: State, rng: np.random.Generator, robot: str
) -> list[Waypoint]:
    """Returns the waypoints of the next skill of a robot from a state of one row; empty gives up."""
    names = (*scene.problem.objects, *scene.fixtures)
    asked, chance = _try_of(rng)
    look = _Look(
        scene=scene,
        goal=goal,
        state=state,
        hand=Hand(ee_pos(state.robots[robot])[0].numpy(), HOME_TILT_RAD, PACE),
        clouds={name: cloud(scene.parts[name], state.objects[name]) for name in names},
    )
    failed = asked > len(goal.atoms)
    for atom in _steps(look):
        if atom.predicate in ("in", "on"):
            way = _place(look, atom, chance if failed else None)
        else:
            way = _joint(look, atom)
        if way:
            return way
    return []


def _try_of(rng: np.random.Generator) -> tuple[int, np.random.Generator]:
    """Returns how often the expert was asked before in an episode, and random numbers of this time alone."""
    seeds = rng.bit_generator.seed_seq
    assert isinstance(seeds, np.random.SeedSequence), "an episode's generator counts what it spawned"
    (own,) = rng.spawn(1)
    return seeds.n_children_spawned - 1, own


def _steps(look: _Look) -> Iterator[Atom]:
    """Yields atoms that do not hold, in the order in which they can be worked on."""
    open_atoms = [atom for atom in look.goal.atoms if not bool(look.goal.holds(atom, look.state)[0])]
    places = [atom for atom in open_atoms if atom.predicate in ("in", "on")]
    needed = {atom.args[1] for atom in places}
    # A drawer that nothing goes into is shut first: one that is open above it would be in the way.
    yield from (atom for atom in open_atoms if atom.predicate == "close" and atom.args[0] not in needed)
    for atom in places:  # what goes into a shut drawer needs it open
        region = look.scene.problem.regions.get(atom.args[1])
        if region is not None and look.scene.categories.get(region.target, "").endswith("cabinet"):
            opens = Atom("open", (atom.args[1],))
            part = look.scene.parts[region.target].site(region.site).part
            joint = look.scene.parts[region.target].parts[part].joint
            if (
                joint is not None
                and look.state.objects[region.target].joint_pos[0, joint.column] > OPEN_ENOUGH_M
            ):
                yield opens
    yield from (atom for atom in open_atoms if atom.predicate == "open")
    moved = {atom.args[0] for atom in places}
    yield from sorted(places, key=lambda atom: _target(look, atom) in moved)
    yield from (atom for atom in open_atoms if atom.predicate == "close" and atom.args[0] in needed)
    yield from (atom for atom in open_atoms if atom.predicate in ("turnon", "turnoff"))


def _target(look: _Look, atom: Atom) -> str:
    region = look.scene.problem.regions.get(atom.args[1])
    return atom.args[1] if region is None else region.target


def _joint(look: _Look, atom: Atom) -> list[Waypoint]:
    region = look.scene.problem.regions.get(atom.args[0])
    name = atom.args[0] if region is None else region.target
    parts, entity = look.scene.parts[name], look.state.objects[name]
    heights = look.heights()
    if JOINT_RULES.get(look.scene.categories[name]) is STOVE:
        part = next(index for index, part in enumerate(parts.parts) if part.joint is not None)
        to = KNOB_ON_RAD if atom.predicate == "turnon" else KNOB_OFF_RAD
        return turn_knob(look.hand, parts, entity, part, to, heights)
    if region is None:
        part = next(index for index, part in enumerate(parts.parts) if part.joint is not None)
        return (
            push_door(look.hand, parts, entity, part, DOOR_SHUT_RAD, heights)
            if atom.predicate == "close"
            else []
        )
    part = parts.site(region.site).part
    to = OPENED_M if atom.predicate == "open" else SHUT_M
    return slide_part(look.hand, parts, entity, part, to, -1.0, heights)


def _place(look: _Look, atom: Atom, rng: np.random.Generator | None) -> list[Waypoint]:
    """Returns a pick and a put; of all pairs of a grasp and a place that fit, one of the best."""
    thing = atom.args[0]
    points = look.clouds[thing]
    if _is_dragged(look, atom):
        goal = _candidates(look, atom)[0]
        alone = Heights([points], look.scene.arena.top_z_m)
        way = goal - look.state.objects[thing].pos[0, :2].numpy()
        return drag(look.hand, points, way, look.heights(), alone)
    base = float(points[:, 2].min())
    grasps = top_grasps(points, look.others(thing), base + LOWEST_GRIP_M, rng)
    heights, candidates = look.heights(without=thing), _candidates(look, atom)
    best: tuple[float, Grasp, np.ndarray, float, Underside] | None = None
    for grasp in grasps[:GRASPS_TRIED]:
        for turn in TURNS:
            found = _place_for(look, atom, candidates, grasp, turn, heights)
            if found is not None and (best is None or found[0] + grasp.score > best[0]):
                best = (found[0] + grasp.score, grasp, *found[1:])
    if best is None:
        return []
    _, grasp, target, yaw, carried = best
    way = pick(look.hand, grasp, look.heights())
    return [*way, *put(look.hand, grasp, carried, target, yaw, heights)]


def _is_dragged(look: _Look, atom: Atom) -> bool:
    """Whether something flat, wider than the hand, goes from place to place on the table."""
    region = look.scene.problem.regions.get(atom.args[1])
    size = np.ptp(look.clouds[atom.args[0]], axis=0)
    on_table = region is not None and region.target in SURFACE_FIXTURES
    return on_table and size[2] < FLAT_M and min(size[:2]) > 2 * FINGER_MOST_M


def _place_for(
    look: _Look,
    atom: Atom,
    candidates: tuple[np.ndarray, np.ndarray],
    grasp: Grasp,
    turn: float,
    heights: Heights,
) -> tuple[float, np.ndarray, float, Underside] | None:
    """Returns score, grip site, yaw and underside of the best place for a grasp, or None."""
    thing = atom.args[0]
    yaw = grasp.yaw + turn
    if abs(yaw) > 2.4:
        return None
    cosine, sine = np.cos(turn), np.sin(turn)
    spin = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    origin = spin @ (look.state.objects[thing].pos[0].numpy() - grasp.pos)
    own = Underside.of((look.clouds[thing] - grasp.pos) @ spin.T)
    hand = hand_underside(yaw, grasp.opening_m, opens_from_m=0.0)
    middle, places = candidates
    grips = places - origin[:2]
    rests = heights.rest(grips, own)
    lets_go = np.maximum(rests, heights.rest(grips, hand))
    ends = np.column_stack([places, rests + origin[2]])
    good = _holds_at(look, atom, ends)
    if not good.any():
        return None
    away = np.linalg.norm(places - middle, axis=1)
    score = -8.0 * away - 6.0 * (lets_go - rests) - 0.4 * abs(turn) - 5.0 * (rests - rests[good].min())
    index = int(np.where(good, score, -np.inf).argmax())
    target = np.array([*grips[index], lets_go[index] + RELEASE_M])
    return float(score[index]), target, yaw, own.joined(hand)


def _candidates(look: _Look, atom: Atom) -> tuple[np.ndarray, np.ndarray]:
    """Returns the middle (2,) of where an object's origin belongs, and places (C, 2) round it."""
    region = look.scene.problem.regions.get(atom.args[1])
    if region is None:
        middle = look.state.objects[atom.args[1]].pos[0, :2].numpy()
        reach = np.array([0.015, 0.015])
    else:
        pos, rot, half = look.goal.site_pose(region, look.state)
        middle = pos[0, :2].numpy()
        reach = (to_matrix(rot[0]) @ half).abs().numpy()[:2] * 0.9
    steps = [np.linspace(-size, size, 2 * max(1, min(6, int(size / 0.01))) + 1) for size in reach]
    grid = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return middle, middle + grid


def _holds_at(look: _Look, atom: Atom, ends: np.ndarray) -> np.ndarray:
    """Returns whether an atom would hold with the object's origin at places (C, 3), contacts aside."""
    pos = torch.from_numpy(ends)
    region = look.scene.problem.regions.get(atom.args[1])
    if region is None:
        return over_object(pos, look.state.objects[atom.args[1]].pos.expand(len(ends), 3)).numpy()
    site, rot, half = look.goal.site_pose(region, look.state)
    site, rot = site.expand(len(ends), 3), rot.expand(len(ends), 4)
    if atom.predicate == "in":
        return in_site(pos, site, rot, half).numpy()
    return over_site(pos, site, rot, half).numpy()
