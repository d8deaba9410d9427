"""Tasks: one file per family, one line here."""

from typing import TYPE_CHECKING

from envs.registry import Registry

if TYPE_CHECKING:
    from envs.tasks.base import Task

TASKS: "Registry[type[Task]]" = Registry("task")
TASKS.add(
    "PickCube",
    "envs.tasks.pick_cube:PickCube",
    tags={"tabletop", "benchmark"},
    summary="grasp a 4 cm cube and hold it at the green marker (ManiSkill)",
)
