"""Demonstrations of other projects: one reader per file format, and the replay that makes them ours.

>>> file = IMPORTERS.get("maniskill")(path, task)                               # doctest: +SKIP
>>> file.read(file.names[0])                                                    # doctest: +SKIP
"""

from typing import TYPE_CHECKING

from envs.core.registry import Registry

if TYPE_CHECKING:
    from roboverse_learn.data.importers.demonstration import DemonstrationFile

IMPORTERS: "Registry[type[DemonstrationFile]]" = Registry("source of demonstrations")
IMPORTERS.add(
    "maniskill",
    "roboverse_learn.data.importers.maniskill:ManiSkillFile",
    extra="import",
    summary="ManiSkill 3 trajectories: HDF5 with env_states, and the JSON beside it",
)
IMPORTERS.add(
    "roboverse",
    "roboverse_learn.data.importers.roboverse:RoboVerseFile",
    summary="RoboVerse v2 trajectories: pickle (read without running it) or JSON, plain or gzipped",
)
IMPORTERS.add(
    "robosuite",
    "roboverse_learn.data.importers.robosuite:RobosuiteFile",
    extra="import",
    summary="robosuite teleoperation: HDF5 with flat MuJoCo states, and the model's XML",
)
