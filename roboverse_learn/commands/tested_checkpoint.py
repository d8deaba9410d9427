"""What is evaluated: a checkpoint, and what is known of how it came about."""

import logging
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from benchmark.protocol import Protocol
from envs.core.errors import ConfigError
from envs.simulators.settings import check_settings
from roboverse_learn.config.preflight_materials import recorded_materials
from roboverse_learn.config.scenario_overrides import checked_scenario, control_hz, learned_hz, scenario_name
from roboverse_learn.config.schema import EvaluateConfig, EvaluationConfig, TrainRunConfig

log = logging.getLogger(__name__)

_VIDEO_PX = 256
"""Pictures of an agent that sees none: its videos."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Subject:
    """What is evaluated, and where it comes from.

    Attributes:
        checkpoint: The LeRobot pretrained folder.
        run: Name of its run.
        task: Task.
        task_kwargs: Options of the task.
        simulator_settings: Settings of the simulator that replace the scene's.
        scenario: What is changed of the task's scene.
        simulator: Physics.
        renderer: Pictures.
        cameras: Cameras that are observed; empty is the task's first.
        image_size: Pixels a side.
        device: Torch device.
        train_tasks: Tasks that were learned together, where there are several.
        train_level: Level of the demonstrations; None where unknown or where one channel varied alone.
        train_only: The channel that varied alone in the demonstrations.
        seed: Seed of the training run.
        dataset_hash: Hash of the training data.
        demonstrations: Episodes of the training data.
        config: Resolved configuration, plain values.
    """

    checkpoint: Path
    run: str
    task: str
    simulator: str
    renderer: str
    image_size: int
    device: str
    train_tasks: tuple[str, ...] = ()
    train_level: int | None = None
    train_only: str | None = None
    seed: int = 0
    task_kwargs: dict[str, Any] = field(default_factory=dict)
    simulator_settings: dict[str, Any] = field(default_factory=dict)
    scenario: dict[str, Any] = field(default_factory=dict)
    cameras: tuple[str, ...] = ()
    dataset_hash: str | None = None
    demonstrations: int | None = None
    config: dict[str, Any] = field(default_factory=dict)


def protocol_of(config: EvaluationConfig) -> Protocol:
    """Returns the protocol that an evaluation follows."""
    return Protocol(
        levels=config.levels,
        only=config.alone,
        splits=config.splits,
        episodes=config.episodes,
        seed=config.protocol_seed,
    )


def subjects_of(config: EvaluateConfig) -> list[Subject]:
    """Returns a subject for the task that was asked for, or for each of those that a checkpoint learned.

    Raises:
        RoboVerseError: as :func:`subject_of`.
    """
    together = () if config.task else _learned_together(Path(config.checkpoint))
    return [subject_of(replace(config, task=task)) for task in together] or [subject_of(config)]


def subject_of(config: EvaluateConfig) -> Subject:
    """Finds out what a checkpoint was trained on, from the run that it lies in.

    Raises:
        ConfigError: It lies in no run, and the task or the image size was not given.
        PolicyError: There is no checkpoint.
    """
    from policies.checkpoint import resolve
    from roboverse_learn.commands.run_folder import read_config, run_of
    from roboverse_learn.config.serialize import to_values

    checkpoint = resolve(config.checkpoint)
    _check_whole(checkpoint)
    folder = run_of(checkpoint)
    if folder is None:
        return _foreign_subject(checkpoint, config)
    trained = read_config(folder)
    # What it was trained on need not be what it is evaluated on: a GPU's run is evaluated anywhere.
    subject = subject_of_run(folder, replace(trained, device=config.device), checkpoint)
    simulator = config.simulator or trained.simulator
    inherited = trained.simulator_settings if simulator == trained.simulator else {}
    differs = {
        "task": config.task or trained.task,
        "task_kwargs": config.task_kwargs or trained.task_kwargs,
        "simulator": simulator,
        "simulator_settings": config.simulator_settings or inherited,
        "renderer": config.renderer or trained.renderer,
        "cameras": config.cameras or trained.cameras,
        "image_size": config.image_size or trained.image_size,
    }
    check_settings(simulator, differs["simulator_settings"])
    differs["scenario"] = checked_scenario(
        differs["task"], differs["task_kwargs"], trained.scenario, config.scenario
    )
    _tell_control_rates(trained, differs)
    changed = [
        _in_name(key, value)
        for key, value in differs.items()
        if value not in (trained.tasks if key == "task" else (getattr(trained, key),))
    ]
    protocol = protocol_of(config.evaluate)
    if protocol.hash != protocol_of(trained.evaluate).hash:
        changed.append(protocol.hash[:6])
    if config.evaluate.materials != trained.evaluate.materials:
        changed.append(_materials_in_name(config.evaluate))
    if step_of(checkpoint) != step_of(resolve(folder)):
        changed.append(f"step{step_of(checkpoint)}")
    values = {"command": to_values(config), "run": to_values(trained), "policy": to_values(trained)["policy"]}
    return replace(
        subject,
        **differs,
        run="-".join([subject.run, *changed]),
        config=values,
    )


def subject_of_run(folder: Path, config: TrainRunConfig, checkpoint: Path) -> Subject:
    """Returns the subject of a run of ours.

    Args:
        folder: The run's folder.
        config: Its configuration.
        checkpoint: The pretrained folder inside it.
    """
    from roboverse_learn.commands.run_folder import read_facts
    from roboverse_learn.config.serialize import to_values
    from roboverse_learn.training.device import resolve_device

    facts = read_facts(folder, "collect")
    return Subject(
        checkpoint=checkpoint,
        run=folder.name,
        task=config.task,
        task_kwargs=config.task_kwargs,
        simulator=config.simulator,
        simulator_settings=config.simulator_settings,
        scenario=config.scenario,
        renderer=config.renderer,
        cameras=config.cameras,
        image_size=config.image_size,
        device=resolve_device(config.device),
        train_tasks=_learned_together(checkpoint),
        train_level=None if config.only else config.level,
        train_only=config.only,
        seed=config.seed,
        dataset_hash=facts.get("dataset_hash"),
        demonstrations=facts.get("num_episodes"),
        config=to_values(config),
    )


def _foreign_subject(checkpoint: Path, config: EvaluateConfig) -> Subject:
    """The subject of a checkpoint that lies in no run of ours, such as one of ``lerobot-train``."""
    from benchmark.provenance import file_hash
    from policies.checkpoint import CONFIG, WEIGHTS, read_json, seen_cameras
    from roboverse_learn.config.serialize import to_values
    from roboverse_learn.training.device import resolve_device

    if not config.task:
        raise ConfigError(
            f"Checkpoint '{checkpoint}' lies in no run of ours, which would say what it was trained on: add "
            "task=<name>."
        )
    check_settings(config.simulator or "mujoco", config.simulator_settings)
    scenario = checked_scenario(config.task, config.task_kwargs, config.scenario)
    values = read_json(checkpoint / CONFIG)
    cameras = seen_cameras(checkpoint)
    sizes = set(cameras.values()) or {_VIDEO_PX}
    if not config.image_size and len(sizes) != 1:
        raise ConfigError(
            f"Checkpoint '{checkpoint}' has images of sizes {sorted(sizes)}: add image_size=<pixels>."
        )
    given = {
        key: getattr(config, key) for key in ("task_kwargs", "simulator", "simulator_settings", "renderer")
    }
    told = [_in_name(key, value) for key, value in {**given, "scenario": scenario}.items() if value]
    if config.evaluate.materials:
        told.append(_materials_in_name(config.evaluate))
    weights = file_hash(checkpoint / WEIGHTS)[:8]
    base = re.sub(r"[^A-Za-z0-9._+=-]+", "-", checkpoint.absolute().parent.name).strip("-.") or "checkpoint"
    return Subject(
        checkpoint=checkpoint,
        run="-".join([base, weights, protocol_of(config.evaluate).hash[:6], *told]),
        task=config.task,
        task_kwargs=config.task_kwargs,
        simulator=config.simulator or "mujoco",
        simulator_settings=config.simulator_settings,
        scenario=scenario,
        renderer=config.renderer or "warp",
        cameras=config.cameras or tuple(cameras),
        image_size=config.image_size or sizes.pop(),
        device=resolve_device(config.device),
        train_tasks=_learned_together(checkpoint),
        config={"command": to_values(config), "policy": values},
    )


def _learned_together(checkpoint: Path) -> tuple[str, ...]:
    """Returns the tasks that the policy of a checkpoint learned together; none where it learned one alone."""
    from policies.checkpoint import learned_tasks

    learned = learned_tasks(checkpoint)
    return learned if len(learned) > 1 else ()


def _check_whole(checkpoint: Path) -> None:
    """Refuses a checkpoint without weights, or of a policy that nobody here can load, by its name."""
    from envs.core.errors import PolicyError
    from policies import config_class
    from policies.checkpoint import WEIGHTS, policy_type

    if not (checkpoint / WEIGHTS).is_file():
        raise PolicyError(f"Checkpoint '{checkpoint}' has no {WEIGHTS}. Name another one, or train again.")
    name = policy_type(checkpoint)
    try:
        config_class(name)
    except PolicyError as error:
        raise PolicyError(f"Checkpoint '{checkpoint}' cannot be evaluated: {error}") from error


def step_of(checkpoint: Path) -> int | None:
    """The training step of a checkpoint, which the name of its folder tells."""
    name = checkpoint.resolve().parent.name
    return int(name) if name.isdecimal() else None


def _tell_control_rates(trained: TrainRunConfig, evaluated: Mapping[str, Any]) -> None:
    """Warns of a policy whose actions were meant to last longer or shorter than they now do."""
    before = learned_hz(trained, evaluated["task"])
    now = control_hz(evaluated["task"], evaluated["task_kwargs"], evaluated["scenario"])
    if before != now:
        log.warning(
            "The policy learned at %g control steps per second and is evaluated at %g. "
            "Leave out scenario.physics to evaluate it as it learned.",
            *(before, now),
        )


def _materials_in_name(config: EvaluationConfig) -> str:
    """The materials of an evaluation as a part of the name of a file."""
    return _in_name("materials", recorded_materials(config.materials) or "built-in-materials")


def _in_name(key: str, value: Any) -> str:
    """A value as a part of the name of a file."""
    if key == "scenario":
        return scenario_name(value)
    text = "-".join(f"{key}={item}" for key, item in value.items()) if isinstance(value, dict) else str(value)
    return re.sub(r"[^A-Za-z0-9._+=-]+", "-", text)
