"""Configuration of every command: frozen dataclasses, whose field names are the command line's keys.

Values come from here, then from the YAML deltas in ``configs/``, then from the command line. This
module is data only; :mod:`roboverse_learn.config.compose` reads words and files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import policies
from benchmark.protocol import LEVELS, SPLITS, check_instruction_tests
from envs.core.errors import ConfigError, unknown_name
from envs.core.ranges import check_ranges
from envs.randomization.levels import channels_of
from envs.randomization.splits import load_split
from envs.spec import EnvSpec
from policies.base import listed
from roboverse_learn.config.other_commands import (
    CheckConfig,
    ConservationConfig,
    ConvertConfig,
    DoctorConfig,
    ExportConfig,
    LeaderboardConfig,
    NewConfig,
    PublishConfig,
    Replay,
    ReplayConfig,
    Split,
    TeleoperateConfig,
    ViewConfig,
)
from roboverse_learn.config.suite_check import check_chains, check_suite, refuse_suite_of_training
from roboverse_learn.config.validation_split import check_validation
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.launch import make_launcher
from roboverse_learn.training.config import TrainConfig


def _within_splits(splits: Sequence[Split], key: str, count: int) -> None:
    """Checks that every split has enough episodes; the message is of the smallest one."""
    sizes = {split: len(load_split(split).episodes) for split in splits}
    smallest = min(sizes, key=lambda split: sizes[split])
    if count <= sizes[smallest]:
        return
    other = "".join(f" or splits=[{split}]" for split in splits if count <= sizes[split])
    raise ConfigError(
        f"{key} must be at most {sizes[smallest]:,}, the {smallest} split's episodes, given {count:,}. "
        f"Give {key}={sizes[smallest]}{other}."
    )


def _levels(*levels: int) -> None:
    """Checks that every level exists."""
    for level in levels:
        if level not in LEVELS:
            raise ConfigError(f"Unknown level {level}. Valid: {', '.join(map(str, LEVELS))}.")


@dataclass(frozen=True, kw_only=True, slots=True)
class DemonstrationConfig:
    """Settings of collection.

    Attributes:
        num_demos: Successful episodes in the dataset.
        num_workers: Processes that collect side by side; 0 takes one per CPU core, or a single one where
            the simulator steps all environments at once.
        num_envs: Environments that each process steps at once.
        steps_per_look: Control steps after which an episode's materials, lights and camera poses change,
            so that no look tells what follows; 0 keeps them.
    """

    num_demos: int = 1000
    num_workers: int = 0
    num_envs: int = 8
    steps_per_look: int = 0

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("num_demos", "num_envs"), from_0=("num_workers", "steps_per_look"))


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluationConfig:
    """Settings of evaluation.

    Attributes:
        levels: Levels to evaluate.
        alone: Channels that are also varied alone, or together, as in camera+lighting.
        splits: Splits to evaluate: train, test, which is the headline, or validation, to choose by.
        episodes: Episodes of each cell, that is of each level and split.
        width: A cell ends once the 95 % interval of its success rate is this narrow, as in 0.1, and
            ``episodes`` is the most; null evaluates all of them.
        instructions: Tests of whether the policy reads its instruction, on the episodes of level 0: known,
            new_frame, new_words (beside known, also what they cost), wrong, empty, switched.
        protocol_seed: Root of the episodes' randomness.
        num_envs: Environments that step at once; on a CPU no result depends on it.
        videos: Videos of successes, and as many of failures, kept of each level.
        materials: Folder of images in place of the built-in materials; with a plus before it, as in
            materials=+images, beside them. 10 % of its images are of the test split.
        other_tasks: Evaluate a policy of demonstrations also in tasks that it did not learn, as with
            suite=grasp/unseen.
    """

    levels: tuple[int, ...] = LEVELS
    alone: tuple[str, ...] = ()
    splits: tuple[Split, ...] = SPLITS
    episodes: int = 100
    width: float | None = None
    instructions: tuple[str, ...] = ()
    protocol_seed: int = 0
    num_envs: int = 10
    videos: int = 1
    materials: str = ""
    other_tasks: bool = False

    def __post_init__(self) -> None:
        _levels(*self.levels)
        for channel in self.alone:
            channels_of(only=channel)
        check_ranges(self, above_0=("episodes", "num_envs"), from_0=("videos", "protocol_seed"))
        check_instruction_tests(self.instructions, self.levels, self.width)
        if not self.splits or not (self.levels or self.alone):
            raise ConfigError("evaluate needs a split and a level, as in splits=[test] levels=[0,1,2,3].")
        _within_splits(self.splits, "episodes", self.episodes)


@dataclass(frozen=True, kw_only=True, slots=True)
class CollectConfig:
    """``roboverse collect``: demonstrations of the expert, a policy or a file into a LeRobot dataset.

    Attributes:
        env: Environment of the demonstrations. Its fields are typed without ``env.``: ``task=PickCube``.
        suite: Registered suite, in place of a task: a dataset for each of its tasks; train takes it where the
            policy learns several tasks.
        preset: Named set of values from ``configs/preset``.
        datasets_dir: Folder of datasets.
        source: Registered source: the task's expert, the policy of ``checkpoint``, the demonstrations in
            ``from`` made into others, or files of this format in ``path``.
        checkpoint: Folder of that policy, trained by reinforcement learning, or of its run.
        path: File of demonstrations, or a folder of them, or of recordings of teleoperation; of files,
            num_demos is the most that is taken.
        replay: How a file's demonstrations become ours: by recorded states, or by controls in our physics.
        only_corrections: Of recordings of teleoperation in which a policy acted, take the person's part
            alone: from where the person took over for the last time.
        from_dataset: Folder of a dataset whose demonstrations are augmented, retargeted or rendered again.
        dataset: Folder of the dataset; empty for one named after the configuration. train takes any
            LeRobotDataset v3, and from it what is not given; without one it collects.
        collect: How demonstrations are collected.
        augment: How demonstrations are augmented.
        tasks_at_once: How many of several tasks are collected, and by train evaluated, in parallel, each in a
            process of its own.
    """

    env: EnvSpec = field(default_factory=EnvSpec)
    suite: str = ""
    preset: str = "full"
    datasets_dir: str = "datasets"
    source: str = "expert"
    checkpoint: str = ""
    path: str = ""
    replay: Replay = "states"
    only_corrections: bool = False
    from_dataset: str = ""
    dataset: str = ""
    collect: DemonstrationConfig = field(default_factory=DemonstrationConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    tasks_at_once: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("tasks_at_once",))
        source = SOURCES.get(self.source)
        source.check_keys(self)
        check_suite(self.suite, dataset=self.dataset)
        if not source.num_demos_is_most:
            _within_splits(("train",), "num_demos", self.collect.num_demos)


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainRunConfig(CollectConfig):
    """``roboverse train``: collect what is missing, train, evaluate, write the leaderboard.

    Attributes:
        policy: Configuration of the policy chosen by ``policy=<name>``.
        policy_name: Registered name of that policy.
        seed: Root of all randomness of training.
        device: ``auto``, ``cpu``, ``cuda``.
        recipe: Name of a recipe in ``configs/recipe``, or a YAML file, in place of a preset.
        run: Folder of a run to continue, or of a new one; empty for one named after the configuration.
        resume: Continue the run of the same configuration; false starts a new one beside it.
        slow_ok: Start even when the run would take very long on this machine.
        dry_run: Check everything, say what is there already and how long the run takes, and print its
            settings; nothing is written.
        runs_dir: Folder of runs.
        results_dir: Folder of results and of the leaderboard.
        train: Optimization.
        evaluate: What the checkpoint is evaluated on afterwards.
    """

    policy: Any = None
    policy_name: str = "act"
    seed: int = 0
    device: str = "auto"
    recipe: str = ""
    run: str = ""
    resume: bool = True
    slow_ok: bool = False
    dry_run: bool = False
    runs_dir: str = "runs"
    results_dir: str = "results"
    train: TrainConfig = field(default_factory=TrainConfig)
    evaluate: EvaluationConfig = field(default_factory=EvaluationConfig)

    def __post_init__(self) -> None:
        # Not super(): a dataclass with slots is another class than the one that super() would look at.
        CollectConfig.__post_init__(self)
        refuse_suite_of_training(self.suite)
        check_ranges(self, from_0=("seed",))
        twice = next((task for task in self.tasks if self.tasks.count(task) > 1), None)
        if twice is not None:
            raise ConfigError(
                f"'{twice}' is learned twice: task={self.env.task}, and policy.tasks="
                f"{listed(self.tasks[1:])}. Name every task once."
            )
        if len(self.tasks) > 1 and self.env.scenario:
            raise ConfigError(
                f"scenario.* change one task, and {len(self.tasks)} are learned together, each in its own "
                "scene. Leave them out, or train each task by itself."
            )
        check_validation(self.evaluate.splits, self.policy_name, self.collect.num_demos)

    @property
    def tasks(self) -> tuple[str, ...]:
        """Every task that is learned: ``task``, and those that the policy learns together with it."""
        return (self.env.task, *getattr(self.policy, "tasks", ()))

    def learned_hz(self, task: str) -> float:
        """Control steps per second at which a task is learned; of another task, those of the first one."""
        return (self.env.replace(task=task) if task in self.tasks else self.env).control_hz


@dataclass(frozen=True, kw_only=True, slots=True)
class SweepConfig:
    """``roboverse sweep``: a run of ``train`` for every combination of the values that its keys are given.

    Attributes:
        recipe: Makes the leaderboard's table by a recipe: its name, several with commas, or a version such as
            v1 for all recipes of that version.
        suite: Registered suite in place of tasks: every run once for each of its tasks.
        tasks: With a recipe: tasks in place of the table's, as in tasks=[PickCube].
        levels: With a recipe: training levels in place of all.
        seeds: With a recipe: seeds in place of 0 to 2, which levels 1 and 2 are trained with too.
        policies: With a recipe: only the recipes of these policies.
        jobs_per_gpu: Runs that share a GPU; on a machine without one, runs at the same time.
        launcher: Where runs are processes: on this machine (local), or batch jobs of a cluster (slurm).
        launcher_settings: Settings of the launcher, as in launcher_settings.partition=gpu.
        dry_run: Print the commands, or the table of a recipe's runs with their state, instead of running.
    """

    recipe: str = ""
    suite: str = ""
    tasks: tuple[str, ...] = ()
    levels: tuple[int, ...] = ()
    seeds: tuple[int, ...] = ()
    policies: tuple[str, ...] = ()
    jobs_per_gpu: int = 1
    launcher: str = "local"
    launcher_settings: Mapping[str, Any] = field(default_factory=dict)
    dry_run: bool = False

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("jobs_per_gpu",))
        make_launcher(self.launcher, self.launcher_settings, self.jobs_per_gpu)
        _levels(*self.levels)
        check_suite(self.suite, tasks=listed(self.tasks) if self.tasks else "")
        only = [key for key in ("tasks", "levels", "seeds", "policies") if getattr(self, key)]
        if only and not self.recipe:
            tested = " Each run is tested at evaluate.levels=[...]." if "levels" in only else ""
            raise ConfigError(
                f"{', '.join(only)} restrict the table of a recipe: add recipe=<name>, as in recipe=act_v1."
                f"{tested}"
            )


def baselines() -> tuple[str, ...]:
    """Returns the values of ``policy`` that ``evaluate`` accepts."""
    return ("expert", *policies.names("nothing"))


EVALUATE_ENV_KEYS = tuple(
    item.name for item in fields(EnvSpec) if item.name not in ("level", "only", "materials")
)
"""Fields of the trained environment that an evaluation may change; its levels and materials are its own."""


@dataclass(frozen=True, kw_only=True, slots=True)
class EvaluateConfig:
    """``roboverse evaluate``: one checkpoint, or a baseline without one, over levels and splits.

    Attributes:
        checkpoint: Checkpoint folder, the folder of a run, or a name on the Hugging Face hub; also typed
            policy.path, as LeRobot does.
        policy_name: In place of a checkpoint, what needs none: the task's expert, or a rule.
        rename_map: Camera of the task to camera of the policy, where they have other names, as in
            {front: camera1}.
        suite: Registered suite in place of a task: every task of it, and their mean.
        chains: With suite=calvin, how many of its 1,000 chains of five instructions, not single tasks.
        first_chain: Index of the first of them.
        protocol: Another benchmark's own protocol, as libero: its starts, interface and number of episodes.
        env: Changes of the environment that the checkpoint was trained in: some of :data:`EVALUATE_ENV_KEYS`.
            What is absent stays as it was trained. ``scenario`` is applied after the trained one's.
        preset: Named set of values from ``configs/preset``.
        device: ``auto``, ``cpu``, ``cuda``.
        results_dir: Folder of results and of the leaderboard.
        evaluate: What the checkpoint is evaluated on.
        tasks_at_once: How many of several tasks are evaluated in parallel, each in a process of its own.
    """

    checkpoint: str = ""
    policy_name: str = ""
    rename_map: dict[str, str] = field(default_factory=dict)
    suite: str = ""
    chains: int = 0
    first_chain: int = 0
    protocol: str = ""
    env: dict[str, Any] = field(default_factory=dict)
    preset: str = "full"
    device: str = "auto"
    results_dir: str = "results"
    evaluate: EvaluationConfig = field(default_factory=EvaluationConfig)
    tasks_at_once: int = 1

    def __post_init__(self) -> None:
        check_ranges(self, above_0=("tasks_at_once",))
        check_suite(self.suite, task=self.env.get("task", ""))
        check_chains(self.suite, self.chains, self.first_chain)
        if self.chains and self.tasks_at_once > 1:
            raise ConfigError(
                f"tasks_at_once={self.tasks_at_once} is for tasks, and chains={self.chains} are evaluated "
                "together. Leave it out; num_envs says how many chains run at once."
            )
        if self.policy_name and not (self.checkpoint and self.policy_name in policies.names()):
            self._check_baseline()
        elif not self.checkpoint:
            raise ConfigError(
                "evaluate needs checkpoint=<folder>: the folder of a run, or a LeRobot checkpoint inside it, "
                "as in checkpoint=runs/PickCube/act/<run>. Without one, give "
                f"policy={' or policy='.join(baselines())} and task=<name>."
            )

    def _check_baseline(self) -> None:
        given = f"policy={self.policy_name}"
        if self.policy_name in policies.names():
            raise ConfigError(
                f"{given} must be trained: give its checkpoint=<folder>, as in "
                f"checkpoint=runs/PickCube/{self.policy_name}/<run>. Without training: "
                f"{', '.join(baselines())}."
            )
        if self.policy_name not in baselines():
            raise unknown_name("policy without training", self.policy_name, baselines())
        if self.checkpoint:
            raise ConfigError(
                f"{given} and checkpoint={self.checkpoint} are both given: which of them is evaluated? Leave "
                "one out; a checkpoint names its policy."
            )
        if "task" not in self.env and not self.suite:
            raise ConfigError(f"{given} needs task=<name>, as in: roboverse evaluate {given} task=PickCube")


COMMANDS: dict[str, type] = {
    "collect": CollectConfig,
    "train": TrainRunConfig,
    "sweep": SweepConfig,
    "evaluate": EvaluateConfig,
    "leaderboard": LeaderboardConfig,
    "check": CheckConfig,
    "new": NewConfig,
    "convert": ConvertConfig,
    "export": ExportConfig,
    "publish": PublishConfig,
    "replay": ReplayConfig,
    "view": ViewConfig,
    "teleoperate": TeleoperateConfig,
    "conservation": ConservationConfig,
    "doctor": DoctorConfig,
}
"""Every command that takes ``key=value`` words, with its configuration."""

NAMES_A_POLICY = ("evaluate", "check")
"""Commands whose ``policy=`` is a name, or nothing, without keys ``policy.*``."""

DEFAULT_PRESETS = {"check": "quick"}
"""Presets of commands whose default is not ``full``."""
