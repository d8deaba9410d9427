"""Sources of demonstrations: the values of ``source=``.

A source is a :class:`~roboverse_learn.data.sources.base.DemonstrationSource` and a line here, or an entry
point in the group ``roboverse.sources`` of another package.
"""

from typing import TYPE_CHECKING

from envs.core.registry import Registry

if TYPE_CHECKING:
    from roboverse_learn.data.sources.base import DemonstrationSource

SOURCES: "Registry[type[DemonstrationSource]]" = Registry("source of demonstrations", "roboverse.sources")
SOURCES.add(
    "expert", "roboverse_learn.data.sources.expert:ExpertSource", summary="the task's scripted expert"
)
SOURCES.add(
    "policy",
    "roboverse_learn.data.sources.policy:PolicySource",
    summary="a policy that was trained by reinforcement learning",
)
SOURCES.add(
    "augment",
    "roboverse_learn.data.sources.augment:AugmentSource",
    summary="pieces of the demonstrations of a dataset, moved with the objects",
)
SOURCES.add(
    "retarget",
    "roboverse_learn.data.sources.retarget:RetargetSource",
    summary="a dataset of another robot: its hand's path, followed by this one in physics",
)
SOURCES.add(
    "rerender",
    "roboverse_learn.data.sources.rerender:RerenderSource",
    summary="a dataset's states, rendered again: at another level, several looks of each episode",
)
SOURCES.add(
    "teleop",
    "roboverse_learn.data.sources.teleop:TeleopSource",
    summary="recordings of a person, made by roboverse teleoperate",
)
SOURCES.add(
    "maniskill",
    "roboverse_learn.data.importers.maniskill:ManiSkillSource",
    extra="import",
    summary="ManiSkill 3 trajectories: HDF5 with env_states, and the JSON beside it",
)
SOURCES.add(
    "roboverse",
    "roboverse_learn.data.importers.roboverse:RoboVerseSource",
    summary="RoboVerse v2 trajectories: pickle (read without running it) or JSON, plain or gzipped",
)
SOURCES.add(
    "robosuite",
    "roboverse_learn.data.importers.robosuite:RobosuiteSource",
    extra="import",
    summary="robosuite teleoperation: HDF5 with flat MuJoCo states, and the model's XML",
)
