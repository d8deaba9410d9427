"""Tasks: a file or a folder per family, a line per task. The class has robot, horizon and instructions.

Other packages register tasks through the entry-point group ``roboverse.tasks``, or by ``TASKS.add`` in a
module that ``plugins=[...]`` names; see ``docs/plugins.md``.
"""

from typing import TYPE_CHECKING

from envs.core.registry import Registry
from envs.tasks.calvin.catalogue import HORIZON as CALVIN_HORIZON
from envs.tasks.calvin.catalogue import entries as calvin_entries
from envs.tasks.grasp_language import catalogue as grasp
from envs.tasks.libero import catalogue as libero
from envs.tasks.metaworld.catalogue import PREFIX, WORDS
from envs.tasks.task_zoo import catalogue as zoo

if TYPE_CHECKING:
    from envs.tasks.base import Task

TASKS: "Registry[type[Task]]" = Registry("task", group="roboverse.tasks")


def _origin(name: str, paper: str, licence: str, family: str = "") -> dict[str, str]:
    """Returns the source of a task; tasks of one ``family`` are listed together."""
    facts = {"source": name, "paper": paper, "licence": licence}
    return {**facts, "family": family} if family else facts


_MANISKILL = _origin("ManiSkill 3", "arXiv:2410.00425", "Apache-2.0")
_ROBOSUITE = _origin("robosuite 1.5", "arXiv:2009.12293", "MIT")
_LIBERO = _origin("LIBERO-object", "arXiv:2306.03310", "MIT; groceries are built from primitives")
_RLBENCH = _origin("RLBench", "arXiv:1909.12271", "numbers alone; the box is RoboVerse's, Apache-2.0")
_CALVIN = _origin("CALVIN", "arXiv:2112.03227", "MIT")
_HUMANOID = _origin("HumanoidBench", "arXiv:2403.10506", "MIT; Unitree's H1 is BSD 3-Clause")
_ISAAC_LAB = _origin("Isaac Lab", "arXiv:2301.04195", "BSD 3-Clause; the ant's shapes are Gymnasium's, MIT")
_SO101 = _origin("LeRobot's SO-101", "arXiv:2506.01844", "own scenes; the arm's dimensions are Apache-2.0")
_TASK_ZOO = _origin("robosuite task zoo", "arXiv:2210.11339", "MIT")
_MIMICGEN = _origin("RoboVerse: after MimicGen", "arXiv:2310.17596", "own primitives; ranges and rules alone")
_METAWORLD = _origin("Meta-World 3", "arXiv:1910.10897", "MIT", family="Meta-World")


def _add(name: str, target: str, summary: str, origin: dict[str, str], *tags: str, extra: str = "") -> None:
    TASKS.add(name, f"envs.tasks.{target}", tags=set(tags), extra=extra or None, summary=summary, info=origin)


for _name, _target, _source, _summary in (
    ("PickCube", "pick_cube", _MANISKILL, "grasp a 4 cm cube and hold it at the green marker"),
    ("StackCube", "stack_cube", _MANISKILL, "put the red cube on the green cube and let go of it"),
    ("NutAssembly", "nut_assembly", _ROBOSUITE, "put the square and the round nut on their pegs"),
    ("CloseBox", "close_box", _RLBENCH, "push the open lid of a box over until it is shut"),
    ("MoveSliderLeft", "move_slider", _CALVIN, "pull the door of a play table to the left by its handle"),
):
    _add(_name, f"{_target}:{_name}", _summary, _source, "tabletop", "benchmark")
_PUDDING = "put the chocolate pudding, one of seven groceries, into the basket"
_add(
    "PickChocolatePudding",
    "pick_chocolate_pudding:PickChocolatePudding",
    _PUDDING,
    _LIBERO,
    "floor",
    "benchmark",
)
for _name, _summary in (
    ("NutAssemblySquare", "put the square nut on its peg"),
    ("NutAssemblyRound", "put the round nut on its peg"),
):
    _add(_name, f"nut_assembly:{_name}", _summary, _ROBOSUITE, "tabletop")

for _name, _target, _summary in (
    ("PushCube", "push_and_pull", "push a cube away from the robot onto a target"),
    ("PullCube", "push_and_pull", "pull a cube towards the robot onto a target"),
    ("LiftPegUpright", "pegs", "stand a lying peg on its end"),
    ("PlaceSphere", "place_sphere", "put a ball into a shallow bin and let go of it"),
    ("PokeCube", "pegs", "push a cube onto a target with the head of a peg"),
    ("RollBall", "roll_ball", "roll a ball over a target at the other end of the table"),
    ("PullCubeTool", "pull_cube_tool", "pull a far cube near with an L-shaped tool"),
    ("PegInsertionSide", "peg_insertion", "put a peg into the hole in the side of a box"),
    ("PlugCharger", "plug_charger", "put the pins of a charger into a receptacle"),
    ("StackPyramid", "stack_pyramid", "put two cubes side by side and a third one on both"),
    ("PushT", "push_t", "push a T-shaped block onto its outline with a stick"),
    ("TwoRobotPickCube", "two_robots", "one arm hands a cube over the middle, the other lifts it to a goal"),
    (
        "TwoRobotStackCube",
        "two_robots",
        "one arm puts a cube on a target, the other stacks one on it",
    ),
):
    _add(_name, f"maniskill.{_target}:{_name}", _summary, _MANISKILL, "tabletop")

for _name, _target, _summary in (
    ("Lift", "cubes", "grasp a cube and lift it off the table"),
    ("Stack", "cubes", "put a small cube on a larger one and let go of it"),
    ("Door", "door", "turn the handle of a door and pull the door open"),
    ("PickPlaceCan", "pick_place", "put a can into its compartment of the other bin"),
    ("PickPlaceMilk", "pick_place", "put a milk carton into its compartment of the other bin"),
    ("PickPlaceBread", "pick_place", "put a loaf of bread into its compartment of the other bin"),
    ("PickPlaceCereal", "pick_place", "put a cereal box into its compartment of the other bin"),
    ("PickPlace", "pick_place_all", "put milk, bread, cereal and a can each into its compartment"),
    ("Wipe", "wipe", "wipe a line of dirt off the table"),
    ("ToolHang", "tool_hang", "put a hook frame into a stand and hang a wrench on the hook"),
    ("TwoArmLift", "two_arm_lift", "lift a pot by both of its handles with two arms"),
    (
        "TwoArmTransport",
        "two_arm_transport",
        "bring a hammer from a covered bin into one that is cleared first",
    ),
    ("TwoArmHandover", "two_arm_handover", "one arm picks up a hammer and hands it to the other"),
    ("TwoArmPegInHole", "two_arm_peg_in_hole", "one arm puts its peg into the hole of the other's plate"),
):
    _add(_name, f"robosuite.{_target}:{_name}", _summary, _ROBOSUITE, "tabletop")

for _name, _target, _summary in (
    ("HammerPlace", "hammer_place", "put a hammer into a drawer that is pulled open and pushed shut"),
    ("ToolUse", "tool_use", "pull a far cube near with an L-shaped tool and put it into a pot"),
    ("Kitchen", "kitchen", "cook bread in a pot on a stove that is turned on and off, and serve it"),
):
    _add(_name, f"task_zoo.{_target}:{_name}", _summary, _TASK_ZOO, "tabletop")
for _name, _entry in zoo.entries().items():
    _add(_name, f"task_zoo.multitask:{_name}", _entry.instructions[0], _TASK_ZOO, "tabletop")

for _name, _target, _summary in (
    ("Threading", "threading", "put a needle through a ring on a stand"),
    ("ThreePieceAssembly", "three_pieces", "put a block into a frame, and a second one into the first"),
    ("Coffee", "coffee", "put a pod into a coffee machine and shut its lid"),
    ("MugCleanup", "mug_cleanup", "stand a mug in a drawer that is pulled open and pushed shut"),
):
    _add(_name, f"assembly.{_target}:{_name}", _summary, _MIMICGEN, "tabletop")

for _name, _target, _summary in (
    ("stand", "locomotion:Stand", "stand upright and keep still for 20 s"),
    ("walk", "locomotion:Walk", "walk forwards at 1 m/s"),
    ("run", "locomotion:Run", "run forwards at 5 m/s"),
    ("crawl", "obstacles:Crawl", "crawl through a low tunnel"),
    ("hurdle", "obstacles:Hurdle", "run over ten hurdles"),
    ("stair", "obstacles:Stair", "walk up and down stairs"),
    ("slide", "obstacles:Slide", "walk up and down ramps"),
    ("pole", "obstacles:Pole", "walk between poles without touching them"),
    ("maze", "obstacles:Maze", "walk through a maze from marker to marker"),
    ("sit_simple", "obstacles:SitSimple", "sit down on the chair behind"),
    ("sit_hard", "obstacles:SitHard", "sit down on a chair that can be pushed away"),
    ("balance_simple", "obstacles:BalanceSimple", "stand on a board that tips on a ball"),
    ("balance_hard", "obstacles:BalanceHard", "stand on a board on a rolling ball"),
):
    _add(f"humanoid/{_name}", f"humanoid.{_target}", _summary, _HUMANOID, "humanoid", "rl", extra="humanoid")

for _name, _summary in (
    ("stand", "stand upright with two hands of five fingers and keep still for 20 s"),
    ("walk", "walk forwards at 1 m/s with two hands of five fingers"),
    ("run", "run forwards at 5 m/s with two hands of five fingers"),
):
    _target = f"humanoid.locomotion:{_name.title()}WithHands"
    _add(f"humanoid/h1hand_{_name}", _target, _summary, _HUMANOID, "humanoid", "rl", "hands")

for _name, _target, _summary in (
    ("cartpole", "cartpole:Cartpole", "push a cart so that the pole on it stays upright"),
    ("ant", "ant:Ant", "run on four legs"),
    ("franka_reach", "reach:FrankaReach", "bring the hand to a commanded pose"),
):
    _add(f"control/{_name}", f"control.{_target}", _summary, _ISAAC_LAB, "control", "rl")

for _name, _target, _summary in (
    ("pick_cube", "cubes:PickCube", "grasp a 3 cm cube and lift it"),
    ("stack_cube", "cubes:StackCube", "put the red cube on the green cube and let go of it"),
    ("push_cube", "cubes:PushCube", "push a cube onto a target with closed fingers"),
    ("open_drawer", "drawer:OpenDrawer", "pull a small drawer open by its handle"),
):
    _add(f"so101/{_name}", f"so101.{_target}", _summary, _SO101, "tabletop", "so101")

_EXTRA = "metaworld"
for _name, _summary in (
    ("DrawerOpen", "pull a drawer open by its handle"),
    ("DrawerClose", "push an open drawer in"),
    ("DoorClose", "push the open door of a safe shut"),
    ("WindowOpen", "slide a window open"),
    ("WindowClose", "slide an open window shut"),
):
    _add(_name, f"metaworld.furniture:{_name}", _summary, _METAWORLD, "tabletop", _EXTRA, extra=_EXTRA)
for _name, _words in WORDS.items():
    _add(PREFIX + _name, f"metaworld.others:{_name}", _words[0], _METAWORLD, _EXTRA, "adapted", extra=_EXTRA)

_LIBERO_ASSETS = "MIT; objects of HOPE (CC BY-NC-SA), Google's scans (CC BY 4.0) and TurboSquid"
for _name, _entry in (libero.entries() | libero.pro_entries()).items():
    _suite = "LIBERO-PRO" if _entry.variant else f"LIBERO-{_entry.suite}"
    _paper = "arXiv:2510.03827" if _entry.variant else "arXiv:2306.03310"
    _facts = _origin(_suite, _paper, _LIBERO_ASSETS, family=_suite)
    _facts |= {"robot": "franka", "horizon": str(libero.HORIZON)}
    _target = f"libero.by_name:{_entry.class_name}"
    _add(_name, _target, _entry.instruction, _facts, libero.EXTRA, "tabletop", extra=_entry.extra)

for _name, _entry in calvin_entries().items():
    _family = f"CALVIN, scene {_entry.scene}"
    _facts = _origin("CALVIN", "arXiv:2112.03227", "MIT", family=_family)
    _facts |= {"robot": "franka", "horizon": str(CALVIN_HORIZON)}
    _add(_name, f"calvin.by_name:{_entry.class_name}", _entry.facts.instruction, _facts, "tabletop", "calvin")

_GRASP = _origin(
    "RoboVerse: language grasping", "arXiv:2504.18904", _LIBERO_ASSETS, family="Grasping by language"
)
_GRASP |= {"robot": "franka", "horizon": str(grasp.HORIZON)}
for _name, _entry in grasp.entries().items():
    _target = f"grasp_language.by_name:{_entry.class_name}"
    _words = f"{_entry.instructions[0]}, one of {len(grasp.in_scene(_entry.set))} groceries"
    _tags = ["tabletop"] if _entry.target == grasp.in_scene(_entry.set)[0] else ["tabletop", "same_scene"]
    _add(_name, _target, _words, _GRASP, *_tags, extra=grasp.EXTRA)
