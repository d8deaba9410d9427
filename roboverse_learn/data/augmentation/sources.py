"""Reads the source demonstrations of an augmentation from a dataset, and cuts them into the same pieces."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from envs.core.errors import ConfigError, DatasetError
from envs.tasks.base import Task
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.augmentation.movements import movements
from roboverse_learn.data.augmentation.pieces import Piece, cut, cut_as_stated, sped_up, vote
from roboverse_learn.data.augmentation.planner import Source
from roboverse_learn.data.augmentation.recording import HandReader, SourceDemo
from roboverse_learn.data.augmentation.references import References
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.recorded_scene import check_not_merged, what_to_give
from roboverse_learn.data.dataset.recording import Recording, read_recordings

TIME_SHARE = 0.6
"""Share of the task's time that what is kept of a source may take; the rest is for bridges and retries."""


@dataclass(frozen=True, eq=False)
class SourceSet:
    """The source demonstrations of one dataset.

    Attributes:
        sources: Those that do the same, with their pieces.
        sequence: What they do, in words.
        left_out: Each other demonstration to what it does.
        own_episodes: Episodes of the pool that the dataset's demonstrations are of.
        digest: First digits of the SHA-256 of their recorded states.
    """

    sources: tuple[Source, ...]
    sequence: str
    left_out: dict[int, str]
    own_episodes: frozenset[int]
    digest: str

    def __str__(self) -> str:
        """Returns what the sources do, and which demonstrations are left out, and why."""
        listed = "; ".join(
            f"demonstration {index}: {words or 'nothing'}" for index, words in self.left_out.items()
        )
        every = f"{len(self.sources)} of {len(self.sources) + len(self.left_out)}"
        return (
            f"{every} source demonstrations do the same: {self.sequence}."
            + f" Left out: {listed}." * bool(listed)
        )


def digest_of(root: str | Path, count: int) -> str:
    """Returns the first digits of the SHA-256 of the recorded states of ``count`` episodes; 0 is all."""
    info, digest = DatasetInfo.open(root), hashlib.sha256()
    for index in range(min(count or info.num_episodes, info.num_episodes)):
        path = info.raw_file(index)
        digest.update(path.read_bytes() if path.exists() else b"")
    return digest.hexdigest()[:16]


def read_sources(root: str | Path, task: Task, config: AugmentConfig) -> SourceSet:
    """Reads source demonstrations, and keeps those that do what most of them do.

    Raises:
        ConfigError: They are of several tasks or robots, of another task, robot or split, or fewer than
            ``augment.num_sources``.
        DatasetError: There is no dataset, it has no recorded states, or no common sequence of movements.
    """
    info = DatasetInfo.open(root)
    if config.num_sources > info.num_episodes:
        raise ConfigError(
            f"augment.num_sources={config.num_sources} was given, and from={root} holds {info.num_episodes} "
            "demonstrations. Give at most as many, or collect more there."
        )
    check_not_merged(root, info.episode_metadata)
    recordings = read_recordings(root, config.num_sources)
    _check_origin(root, task, recordings)
    reader, references = HandReader.of(task), References(task.scenario)
    hz, demos, pieces, words = task.scenario.physics.control_hz, [], [], []
    for recording in recordings:
        demo = reader.demo(recording.index, recording.states)
        found, said = _cut(demo, task, references, hz, config)
        demos.append(demo)
        pieces.append(sped_up(found, TIME_SHARE * task.max_episode_steps))
        words.append(said)
    kept = vote([demo.index for demo in demos], pieces, words)
    left_out = {demo.index: words[row] for row, demo in enumerate(demos) if row not in kept}
    return SourceSet(
        sources=tuple(Source(demos[row], pieces[row]) for row in kept),
        sequence=words[kept[0]],
        left_out=left_out,
        own_episodes=frozenset(int(recording.metadata["episode"]) for recording in recordings),
        digest=digest_of(root, config.num_sources),
    )


def _cut(
    demo: SourceDemo, task: Task, references: References, control_hz: float, config: AugmentConfig
) -> tuple[tuple[Piece, ...], str]:
    """Returns the pieces of a demonstration, and its sequence in words."""
    if task.segments:
        try:
            stated = cut_as_stated(demo, task.segments, refine=config.refine_grasp)
        except DatasetError as error:
            return (), str(error)
        return stated, ", then ".join(f"at {segment.reference}" for segment in task.segments)
    found = movements(demo, references, control_hz, config.least_steps)
    return cut(demo, found, refine=config.refine_grasp), ", then ".join(map(str, found))


def _check_origin(root: str | Path, task: Task, recordings: list[Recording]) -> None:
    """Checks that recordings are of the task, of its robot and of the train split."""
    robot, objects = task.scenario.robots[0], [item.name for item in task.scenario.objects]
    for recording in recordings:
        facts, states = recording.metadata, recording.states
        if facts["task"] != task.name:
            raise ConfigError(
                f"from={root} holds demonstrations of {facts['task']}, and task={task.name} was given: "
                f"{what_to_give('task', facts['task'])}."
            )
        if facts["split"] != "train":
            raise ConfigError(
                f"Demonstration {recording.index} of from={root} is of the {facts['split']} split, which is "
                "for evaluation alone. Give demonstrations of the train split."
            )
        missing = [name for name in objects if name not in states.objects]
        if missing:
            raise ConfigError(
                f"The scene of from={root} has no {', '.join(missing)}, which {task.name} has with these "
                "options. Give the task_kwargs that it was collected with."
            )
        if robot.name not in states.robots or (
            states.robots[robot.name].joint_pos.shape[1] != len(robot.joint_names)
        ):
            theirs = next(iter(states.robots))
            raise ConfigError(
                f"from={root} holds demonstrations of robot '{theirs}', and {task.name} has '{robot.name}' "
                f"with {len(robot.joint_names)} joints. Add robot={theirs}, or make demonstrations of "
                f"'{robot.name}' of them first, by roboverse collect source=retarget."
            )
