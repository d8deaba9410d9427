"""Tasks: one file per family, one line here."""

from typing import TYPE_CHECKING

from envs.core.registry import Registry
from envs.tasks.metaworld.catalogue import PREFIX, WORDS

if TYPE_CHECKING:
    from envs.tasks.base import Task

_MANISKILL = ("ManiSkill 3", "arXiv:2410.00425", "Apache-2.0")
_ROBOSUITE = ("robosuite 1.5", "arXiv:2009.12293", "MIT")
_LIBERO = ("LIBERO-object", "arXiv:2306.03310", "MIT; groceries are drawn by primitives")
_RLBENCH = ("RLBench", "arXiv:1909.12271", "numbers alone; the box is RoboVerse's, Apache-2.0")
_CALVIN = ("CALVIN", "arXiv:2112.03227", "MIT")
_HUMANOID = ("HumanoidBench", "arXiv:2403.10506", "MIT; Unitree's H1 is BSD 3-Clause")
_ISAAC_LAB = ("Isaac Lab", "arXiv:2301.04195", "BSD 3-Clause; the ant's shapes are Gymnasium's, MIT")
_METAWORLD = ("Meta-World 3", "arXiv:1910.10897", "MIT")
"""Name, paper and licence of where a task comes from."""


def _facts(source: tuple[str, str, str], robot: str, horizon: int, family: str = "") -> dict[str, str]:
    """What a listing says of a task without importing it; ``tests/envs/tasks/test_facts.py`` compares."""
    name, paper, licence = source
    facts = {"source": name, "paper": paper, "licence": licence, "robot": robot, "horizon": str(horizon)}
    return {**facts, "family": family} if family else facts


TASKS: "Registry[type[Task]]" = Registry("task")
TASKS.add(
    "PickCube",
    "envs.tasks.pick_cube:PickCube",
    tags={"tabletop", "benchmark"},
    summary="grasp a 4 cm cube and hold it at the green marker",
    info=_facts(_MANISKILL, "franka", 100),
)
TASKS.add(
    "StackCube",
    "envs.tasks.stack_cube:StackCube",
    tags={"tabletop", "benchmark"},
    summary="put the red cube on the green cube and let go of it",
    info=_facts(_MANISKILL, "franka", 200),
)
TASKS.add(
    "NutAssembly",
    "envs.tasks.nut_assembly:NutAssembly",
    tags={"tabletop", "benchmark"},
    summary="put the square and the round nut on their pegs",
    info=_facts(_ROBOSUITE, "franka", 400),
)
TASKS.add(
    "NutAssemblySquare",
    "envs.tasks.nut_assembly:NutAssemblySquare",
    tags={"tabletop"},
    summary="put the square nut on its peg",
    info=_facts(_ROBOSUITE, "franka", 250),
)
TASKS.add(
    "PickChocolatePudding",
    "envs.tasks.pick_chocolate_pudding:PickChocolatePudding",
    tags={"floor", "benchmark"},
    summary="put the chocolate pudding, one of seven groceries, into the basket",
    info=_facts(_LIBERO, "franka", 250),
)
TASKS.add(
    "CloseBox",
    "envs.tasks.close_box:CloseBox",
    tags={"tabletop", "benchmark"},
    summary="push the open lid of a box over until it is shut",
    info=_facts(_RLBENCH, "franka", 200),
)
TASKS.add(
    "MoveSliderLeft",
    "envs.tasks.move_slider:MoveSliderLeft",
    tags={"tabletop", "benchmark"},
    summary="pull the sliding door of a play table to the left by its handle",
    info=_facts(_CALVIN, "franka", 150),
)
for _name, _summary in {
    "stand": "stand upright and keep still for 20 s",
    "walk": "walk forwards at 1 m/s",
    "run": "run forwards at 5 m/s",
    "crawl": "crawl through a low tunnel",
    "hurdle": "run over ten hurdles",
    "stair": "walk up and down stairs",
    "slide": "walk up and down ramps",
    "pole": "walk between poles without touching them",
    "maze": "walk through a maze from marker to marker",
    "sit_simple": "sit down on the chair behind",
    "sit_hard": "sit down on a chair that can be pushed away",
    "balance_simple": "stand on a board that tips on a ball",
    "balance_hard": "stand on a board on a rolling ball",
}.items():
    _module = "locomotion" if _name in ("stand", "walk", "run") else "obstacles"
    TASKS.add(
        f"humanoid/{_name}",
        f"envs.tasks.humanoid.{_module}:{_name.title().replace('_', '')}",
        tags={"humanoid", "rl"},
        extra="humanoid",
        summary=_summary,
        info=_facts(_HUMANOID, "h1", 1000),
    )
for _name, (_class, _robot, _horizon, _summary) in {
    "cartpole": ("cartpole:Cartpole", "cartpole", 300, "push a cart so that the pole on it stays upright"),
    "ant": ("ant:Ant", "ant", 960, "run on four legs"),
    "franka_reach": ("reach:FrankaReach", "franka", 120, "bring the hand to a commanded pose"),
}.items():
    TASKS.add(
        f"control/{_name}",
        f"envs.tasks.control.{_class}",
        tags={"control", "rl"},
        summary=_summary,
        info=_facts(_ISAAC_LAB, _robot, _horizon),
    )
for _name, _summary in {
    "DrawerOpen": "pull a drawer open by its handle",
    "DrawerClose": "push an open drawer in",
    "DoorClose": "push the open door of a safe shut",
    "WindowOpen": "slide a window open",
    "WindowClose": "slide an open window shut",
}.items():
    TASKS.add(
        _name,
        f"envs.tasks.metaworld.furniture:{_name}",
        tags={"tabletop", "metaworld"},
        extra="metaworld",
        summary=_summary,
        info=_facts(_METAWORLD, "sawyer", 500, family="Meta-World"),
    )
for _name, _words in WORDS.items():
    TASKS.add(
        f"{PREFIX}{_name}",
        f"envs.tasks.metaworld.others:{_name}",
        tags={"metaworld", "adapted"},
        extra="metaworld",
        summary=_words[0],
        info=_facts(_METAWORLD, "sawyer", 500, family="Meta-World"),
    )
