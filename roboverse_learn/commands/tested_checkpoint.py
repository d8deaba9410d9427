"""The checkpoint that is evaluated, the environment it is evaluated in, and how it was trained."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmark.protocol import Protocol
from envs.core.errors import ConfigError
from envs.core.machine import check_device_name
from envs.simulators.settings import check_settings
from envs.spec import EnvSpec
from envs.tasks.protocols import check_protocol
from roboverse_learn.commands.checkpoint_names import name_without_run
from roboverse_learn.commands.learned_robots import (
    Learned,
    learned_in_run,
    learned_without_run,
    recorded_robots,
    warn_of_joints,
)
from roboverse_learn.commands.learned_tasks import known_tasks, learned_together
from roboverse_learn.commands.scene_labels import fit_for_a_file, recorded_materials, scenario_name
from roboverse_learn.config.scenario_overrides import checked_scenario
from roboverse_learn.config.schema import (
    EVALUATE_ENV_KEYS,
    EvaluateConfig,
    EvaluationConfig,
    TrainRunConfig,
)
from roboverse_learn.config.validation_split import check_validation

log = logging.getLogger(__name__)

_VIDEO_PX = 256
"""Image size of the videos of a policy that observes no images, pixels."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Training:
    """Facts of the training of a checkpoint.

    Attributes:
        tasks: Tasks that were learned together, or the one that was where another is tested; else empty.
        level: Level of the demonstrations; None where unknown or where one channel varied alone.
        only: The channel that varied alone in the demonstrations.
        seed: Seed of the run.
        dataset_hash: Hash of the demonstrations.
        demonstrations: Number of demonstrations.
        recipe: Name of the recipe; empty without one.
    """

    tasks: tuple[str, ...] = ()
    level: int | None = None
    only: str | None = None
    seed: int = 0
    dataset_hash: str | None = None
    demonstrations: int | None = None
    recipe: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class TestedCheckpoint:
    """A checkpoint, or a baseline, and the environment that it is evaluated in.

    Attributes:
        checkpoint: The LeRobot pretrained folder; None for a baseline.
        baseline: What acts without a checkpoint: one of ``schema.baselines()``, empty for a checkpoint.
        run: Name of the evaluation, unique for a task and policy.
        env: Environment; its level, channel and materials are those of each cell of the evaluation.
        device: Torch device.
        rename_map: Camera of the task to camera of the policy, where they have other names.
        training: How it was trained.
        config: Resolved configuration, plain values.
    """

    __test__ = False  # no test class, whatever pytest takes from the name

    checkpoint: Path | None
    baseline: str = ""
    run: str
    env: EnvSpec
    device: str
    rename_map: Mapping[str, str] = field(default_factory=dict)
    training: Training = field(default_factory=Training)
    config: dict[str, Any] = field(default_factory=dict)

    def with_task(self, task: str) -> "TestedCheckpoint":
        """Returns the same checkpoint in another task."""
        return replace(self, env=self.env.replace(task=task))


def protocol_of(config: EvaluationConfig) -> Protocol:
    """Returns the protocol of an evaluation."""
    return Protocol(
        levels=config.levels,
        only=config.alone,
        splits=config.splits,
        episodes=config.episodes,
        seed=config.protocol_seed,
        width=config.width,
        instructions=config.instructions,
    )


def checkpoints_to_test(config: EvaluateConfig) -> list[TestedCheckpoint]:
    """Returns the checkpoint, or the baseline, in each task that is named, or else that it was trained on.

    Raises:
        PolicyError: It is known to have learned other tasks, and ``other_tasks`` does not ask for this one.
        RoboVerseError: as :func:`checkpoint_to_test`.
    """
    from policies.checkpoint import check_learned
    from roboverse_learn.config.serialize import task_names

    tasks: Sequence[str] = ()
    if "task" in config.env:
        tasks = task_names(config.env["task"])
    elif config.checkpoint:
        tasks = learned_together(Path(config.checkpoint))
    each = [replace(config, env={**config.env, "task": task}) for task in tasks] or [config]
    found = [to_test(one) for one in each]
    for tested in found:
        if tested.checkpoint is not None:
            given, asked = tested.training.tasks, config.evaluate.other_tasks
            check_learned(tested.checkpoint, tested.env.task, given, other_tasks=asked)
    return found


def to_test(config: EvaluateConfig) -> TestedCheckpoint:
    """Returns the checkpoint, or the baseline, in the task that is named, whatever the run learned."""
    return checkpoint_to_test(config) if config.checkpoint else _baseline(config)


def checkpoint_to_test(config: EvaluateConfig) -> TestedCheckpoint:
    """Finds the run of a checkpoint, and from it the environment of the evaluation.

    Raises:
        ConfigError: It is in no run's folder, and the task or the image size was not given.
        PolicyError: There is no checkpoint, or it learned other tasks.
    """
    from policies.checkpoint import check_learned
    from roboverse_learn.commands.foreign_checkpoint import open_checkpoint
    from roboverse_learn.commands.run_folder import run_of

    checkpoint = open_checkpoint(config.checkpoint)
    _check_whole(checkpoint, config.policy_name)
    folder = run_of(checkpoint)
    if folder is None:
        tested = _checkpoint_without_run(checkpoint, config)
    else:
        tested = _checkpoint_with_run(folder, checkpoint, config)
    check_learned(checkpoint, tested.env.task, other_tasks=config.evaluate.other_tasks)
    learned = known_tasks(checkpoint)
    if not learned or tested.env.task in learned:
        return tested
    return replace(tested, training=replace(tested.training, tasks=learned))


def _checkpoint_with_run(folder: Path, checkpoint: Path, config: EvaluateConfig) -> TestedCheckpoint:
    """Returns a checkpoint of a run, with what the evaluation changes of the environment."""
    from policies.checkpoint import resolve
    from roboverse_learn.commands.run_folder import read_config, step_of
    from roboverse_learn.config.serialize import to_values

    trained = read_config(folder)
    check_protocol(config.protocol, config.env.get("task", trained.env.task))
    check_validation(config.evaluate.splits, trained.policy_name, trained.collect.num_demos)
    env = _changed_env(trained.env, config.env)
    _warn_of_control_rate(trained, env)
    learned = learned_in_run(folder, trained)
    warn_of_joints(learned, env)
    # The device of the evaluation, not of training: what a GPU trained can be evaluated anywhere.
    tested = checkpoint_of_run(folder, replace(trained, device=config.device), checkpoint, learned)
    parts = _changes_in_name(trained, env)
    protocol = protocol_of(config.evaluate)
    if protocol.hash != protocol_of(trained.evaluate).hash:
        parts.append(protocol.hash[:6])
    if config.evaluate.materials != trained.evaluate.materials:
        parts.append(_materials_in_name(config.evaluate))
    if step_of(checkpoint) != step_of(resolve(folder)):
        parts.append(f"step{step_of(checkpoint)}")
    if config.rename_map:
        parts.append(_in_name("rename_map", config.rename_map))
    run = to_values(trained)
    values = {"command": to_values(config), "run": run, "policy": run["policy"]}
    values |= recorded_robots(learned, env)
    name = "-".join([tested.run, *parts])
    return replace(tested, env=env, run=name, rename_map=config.rename_map, config=values)


def checkpoint_of_run(
    folder: Path, config: TrainRunConfig, checkpoint: Path, learned: Learned | None = None
) -> TestedCheckpoint:
    """Returns a checkpoint of a run, to be evaluated in the environment that it was trained in.

    Args:
        folder: The run's folder.
        config: Its configuration.
        checkpoint: The pretrained folder inside it.
        learned: Whose demonstrations it learned; by default as :func:`learned_in_run` finds out.
    """
    from roboverse_learn.commands.run_folder import read_facts, result_name
    from roboverse_learn.config.serialize import to_values
    from roboverse_learn.training.device import resolve_device

    facts = read_facts(folder, "collect")
    return TestedCheckpoint(
        checkpoint=checkpoint,
        run=result_name(folder),
        env=_without_variation(config.env),
        device=resolve_device(config.device),
        training=Training(
            tasks=learned_together(checkpoint),
            level=facts.get("level", None if config.env.only else config.env.level),
            only=facts.get("only", config.env.only),
            seed=config.seed,
            dataset_hash=facts.get("dataset_hash"),
            demonstrations=facts.get("num_episodes"),
            recipe=config.recipe,
        ),
        config=to_values(config) | recorded_robots(learned or learned_in_run(folder, config), config.env),
    )


def _without_variation(env: EnvSpec) -> EnvSpec:
    """Returns an environment without the level, channel and materials of its demonstrations."""
    return env.replace(level=0, only=None, materials="")


def _changed_env(trained: EnvSpec, changes: Mapping[str, Any]) -> EnvSpec:
    """Returns the trained environment with the changes of an evaluation.

    Settings of the simulator carry over to the same simulator alone. Changes of the scene are applied after
    those that it was trained with.
    """
    env = _without_variation(trained)
    if changes.get("simulator", trained.simulator) != trained.simulator:
        env = env.replace(simulator_settings={})
    env = env.replace(**{key: value for key, value in changes.items() if key != "scenario"})
    check_settings(env.simulator, env.simulator_settings)
    changed = (trained.scenario, changes.get("scenario", {}))
    scenario = checked_scenario(env.task, env.task_kwargs, *changed, robot=env.robot)
    return env.replace(scenario=scenario)


def _changes_in_name(trained: TrainRunConfig, env: EnvSpec) -> list[str]:
    """Returns the parts of a run's name where the evaluated environment differs from the trained one."""
    parts = []
    for key in EVALUATE_ENV_KEYS:
        value = getattr(env, key)
        as_trained = value in trained.tasks if key == "task" else value == getattr(trained.env, key)
        if not as_trained:
            parts.append(_in_name(key, value))
    return parts


def _checkpoint_without_run(checkpoint: Path, config: EvaluateConfig) -> TestedCheckpoint:
    """Returns a checkpoint of no run of this project, such as one of ``lerobot-train``."""
    from envs.core.fingerprint import file_hash
    from policies.checkpoint import CONFIG, policy_type, read_json, seen_cameras, weights_path
    from roboverse_learn.commands.foreign_checkpoint import ANY_SIZE, seen_env
    from roboverse_learn.config.serialize import to_values
    from roboverse_learn.training.device import resolve_device

    if "task" not in config.env:
        raise ConfigError(
            f"Checkpoint '{checkpoint}' is in no run folder, whose config.yaml would name its task: add "
            "task=<name>."
        )
    values = read_json(checkpoint / CONFIG)
    if policy_type(checkpoint) in ANY_SIZE:
        seen = seen_env(checkpoint, config.env, config.rename_map)
    else:
        cameras = seen_cameras(checkpoint)
        sizes = set(cameras.values()) or {_VIDEO_PX}
        if "image_size" not in config.env and len(sizes) != 1:
            raise ConfigError(
                f"Checkpoint '{checkpoint}' has images of sizes {sorted(sizes)}: add image_size=<pixels>."
            )
        seen = EnvSpec(cameras=tuple(cameras), image_size=sizes.pop() if len(sizes) == 1 else _VIDEO_PX)
    env = _changed_env(seen, config.env)
    learned = learned_without_run(checkpoint)
    warn_of_joints(learned, env)
    weights = file_hash(weights_path(checkpoint))[:8]
    name = name_without_run(config.checkpoint, checkpoint)
    return TestedCheckpoint(
        checkpoint=checkpoint,
        run="-".join([name, weights, *_evaluation_in_name(config, env, seen)]),
        env=env,
        device=resolve_device(config.device),
        rename_map=config.rename_map,
        training=Training(tasks=learned_together(checkpoint)),
        config={"command": to_values(config), "policy": values, **recorded_robots(learned, env)},
    )


def _baseline(config: EvaluateConfig) -> TestedCheckpoint:
    """Returns a baseline in the scene of its task.

    Raises:
        ConfigError: It is the expert, and the task has none; or there is no device of that name.
    """
    from envs.tasks import TASKS
    from roboverse_learn.config.serialize import to_values

    check_device_name(config.device)
    env = _changed_env(EnvSpec(), config.env)
    if config.policy_name == "expert" and not TASKS.get(env.task).has_expert:
        raise ConfigError(
            f"{env.task} has no scripted expert to evaluate. Give another policy, such as policy=random, or "
            f"train one: roboverse train policy=ppo task={env.task}"
        )
    return TestedCheckpoint(
        checkpoint=None,
        baseline=config.policy_name,
        run="-".join([config.policy_name, *_evaluation_in_name(config, env)]),
        env=env,
        device="cpu",
        config={"command": to_values(config)},
    )


def _evaluation_in_name(config: EvaluateConfig, env: EnvSpec, seen: EnvSpec | None = None) -> list[str]:
    """Returns the protocol and the changed environment of what was not trained here, as parts of a name.

    Images are in it where they are not those that a checkpoint has ``seen``; a baseline sees none.
    """
    named = ("task_kwargs", "robot", "simulator", "simulator_settings", "renderer")
    parts = [protocol_of(config.evaluate).hash[:6]]
    parts += [_in_name(key, config.env[key]) for key in named if key in config.env]
    if seen is not None:
        images = {key: getattr(env, key) for key in ("cameras", "image_size")}
        parts += [_in_name(key, value) for key, value in images.items() if value != getattr(seen, key)]
    if env.scenario:
        parts.append(_in_name("scenario", env.scenario))
    if config.evaluate.materials:
        parts.append(_materials_in_name(config.evaluate))
    if config.rename_map:
        parts.append(_in_name("rename_map", config.rename_map))
    return parts


def _check_whole(checkpoint: Path, expected: str) -> None:
    """Checks that a checkpoint has weights, and that its policy is registered and the expected one."""
    from envs.core.errors import PolicyError, UnknownNameError
    from policies import config_class
    from policies.checkpoint import WEIGHTS, policy_type, weights_path
    from roboverse_learn.commands.run_folder import of_its_plugins, run_of

    if not weights_path(checkpoint).is_file():
        raise PolicyError(f"Checkpoint '{checkpoint}' has no {WEIGHTS}. Name another one, or train again.")
    name = policy_type(checkpoint)
    try:
        config_class(name)
    except UnknownNameError as error:
        folder = run_of(checkpoint)
        why = error if folder is None else of_its_plugins(error, folder)
        raise PolicyError(f"Checkpoint '{checkpoint}' cannot be evaluated: {why}") from error
    if expected not in ("", name):
        raise ConfigError(
            f"policy={expected} and checkpoint={checkpoint} are both given, and the checkpoint is of "
            f"policy={name}. "
            "Leave policy out; a checkpoint names its policy."
        )


def _warn_of_control_rate(trained: TrainRunConfig, env: EnvSpec) -> None:
    """Warns where the control rate differs from that of training."""
    before, now = trained.learned_hz(env.task), env.control_hz
    if before != now:
        log.warning(
            "The policy learned at %g control steps per second and is evaluated at %g. %s",
            *(before, now),
            "Leave out scenario.physics to evaluate it as it learned."
            if env.task in trained.tasks
            else f"{env.task}, which it did not learn, has that rate.",
        )


def _materials_in_name(config: EvaluationConfig) -> str:
    """Returns the materials of an evaluation as a part of a file name."""
    return _in_name("materials", recorded_materials(config.materials) or "built-in-materials")


def _in_name(key: str, value: Any) -> str:
    """Returns a value as a part of a file name."""
    if key == "scenario":
        return scenario_name(value)
    text = "-".join(f"{key}={item}" for key, item in value.items()) if isinstance(value, dict) else str(value)
    return fit_for_a_file(text)
