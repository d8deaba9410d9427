"""Contracts of a task as data: its class, its words, and its initial states; no simulator is needed."""

import inspect
from dataclasses import MISSING, fields, is_dataclass
from typing import ClassVar, get_origin

import torch

from envs.randomization import channel_rng
from envs.state import EntityState, State
from envs.tasks import TASKS
from envs.tasks.base import Task
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import contract, counted, require

_NUM_STARTS = 4

_SOFT_RAD = 1e-3
"""How far beyond a joint's limit a start may be, rad (m): limits give way to what presses on them."""


@contract()
def options(checked: CheckedTask) -> str:
    """A frozen dataclass of options with defaults: equal options make equal tasks."""
    cls = checked.task_class
    named = getattr(cls, "__qualname__", repr(cls))
    require(
        isinstance(cls, type) and issubclass(cls, Task),
        f"{named} is no subclass of envs.tasks.base.Task. Derive from it.",
    )
    require(
        is_dataclass(cls) and cls.__dataclass_params__.frozen and not _undeclared(cls),  # pyright: ignore[reportAttributeAccessIssue]
        f"{named} is no frozen dataclass. Write @dataclass(frozen=True, kw_only=True) above the class.",
    )
    items = [item for item in fields(cls) if item.init]  # pyright: ignore[reportArgumentType]
    bare = [item.name for item in items if item.default is MISSING is item.default_factory]
    require(not bare, f"{named} has no default of {', '.join(bare)}. Give every option one.")
    lacking = sorted(cls.__abstractmethods__)
    require(not lacking, f"{named} lacks {', '.join(lacking)}. Define it as envs.tasks.base.Task says.")
    known = [item.name for item in items]  # action_space=hand is no field
    given = {key: value for key, value in checked.spec.task_kwargs.items() if key in known}
    one, other = (cls(**given) for _ in range(2))
    try:
        same = one == other and hash(one) == hash(other)
    except TypeError as error:
        require(False, f"Options of {named} cannot be hashed ({error}). Use tuples for lists.")
    else:
        require(same, f"Two tasks {named} of the same options differ. Keep the dataclass's own __eq__.")
    return counted(len(items), "option") if items else "no options"


def _undeclared(cls: type) -> list[str]:
    """Returns annotated options that are no fields, for the class has no decorator of its own."""
    known = cls.__dataclass_fields__  # pyright: ignore[reportAttributeAccessIssue]
    own = inspect.get_annotations(cls)
    return [name for name, kind in own.items() if name not in known and get_origin(kind) is not ClassVar]


@contract("options")
def words(checked: CheckedTask) -> str:
    """A registered name, instructions in words, a limit of steps, and a line for listings."""
    task = checked.task
    require(
        task.name == checked.spec.task,
        f"The class says name = '{task.name}' and is registered as '{checked.spec.task}'. Make them equal.",
    )
    require(
        isinstance(task.instructions, tuple) and task.instructions,
        "instructions is empty. Give a tuple of sentences that say what to do.",
    )
    bad = [
        text for text in task.instructions if not isinstance(text, str) or not text or text != text.strip()
    ]
    require(not bad, f"instructions has {bad[:1]}. Each is a sentence without spaces at its ends.")
    twice = len(task.instructions) - len(set(task.instructions))
    require(not twice, "instructions names one sentence twice. Leave one out.")
    for text in task.instructions:
        require(
            text in task.wordings(text).known,
            f"wordings('{text}') lacks the instruction among its known wordings. Put it there.",
        )
    require(
        isinstance(task.max_episode_steps, int) and task.max_episode_steps > 1,
        f"max_episode_steps is {task.max_episode_steps!r}. Give a number of control steps above 1.",
    )
    require(TASKS.entry(checked.spec.task).summary, "Add summary='…' to TASKS.add: a line for listings.")
    return f"{counted(len(task.instructions), 'instruction')}, {task.max_episode_steps} steps"


@contract("options")
def scenario(checked: CheckedTask) -> str:
    """The scene is data, and the same each time: a robot, objects, cameras."""
    first, second = checked.task.scenario, checked.task.scenario
    require(first == second, "scenario gave two different scenes. Make it of the task's options alone.")
    require(first.robots, "The scenario has no robot. Name one in robots=(…,); the first one acts.")
    parts = ((first.robots, "robot"), (first.objects, "object"), (first.cameras, "camera"))
    return ", ".join(counted(len(items), noun) for items, noun in parts)


@contract("scenario")
def initial_states(checked: CheckedTask) -> str:
    """Everything in the scene has a finite start; row i depends on generator i alone."""
    task = checked.task
    together = task.initial_state([channel_rng(0, "task", i) for i in range(_NUM_STARTS)])
    _check_names(task, together)
    for name, entity in together.entities().items():
        _check_start(name, entity)
    for robot in task.scenario.robots:
        _check_joints(robot, together.robots[robot.name])
    alone = task.initial_state([channel_rng(0, "task", 2)])
    for key, value in alone.flatten().items():
        require(
            torch.equal(value[0], together.flatten()[key][2]),
            f"{key} of row 2 differs between a batch of {_NUM_STARTS} and one alone. Draw the numbers of a "
            "row from its own generator only, in the same order.",
        )
    again = task.initial_state([channel_rng(0, "task", i) for i in range(_NUM_STARTS)])
    require(
        all(torch.equal(value, again.flatten()[key]) for key, value in together.flatten().items()),
        "initial_state gave two answers for equal generators. Use no other source of randomness.",
    )
    return f"{_NUM_STARTS} rows, bit-identical"


def _check_names(task: Task, state: State) -> None:
    """Checks that a state has what the scenario has; what never moves may be absent."""
    scene = task.scenario
    stays = {item.name for item in scene.objects if item.kind != "free"}
    for kind, given, names, optional in (
        ("robots", set(state.robots), {item.name for item in scene.robots}, set()),
        ("objects", set(state.objects), {item.name for item in scene.objects}, stays),
    ):
        require(
            names - optional <= given <= names,
            f"initial_state gives the {kind} {sorted(given)}; the scenario has {sorted(names)}. Give each.",
        )


def _check_start(name: str, entity: EntityState) -> None:
    """Checks the shapes and numbers of one thing's start."""
    for part, size in (("pos", 3), ("rot", 4), ("lin_vel", 3), ("ang_vel", 3)):
        value = getattr(entity, part)
        require(
            tuple(value.shape) == (_NUM_STARTS, size),
            f"{part} of '{name}' has the shape {tuple(value.shape)} for {_NUM_STARTS} generators; it must be "
            f"{(_NUM_STARTS, size)}.",
        )
        require(bool(torch.isfinite(value).all()), f"{part} of '{name}' is not finite at the start.")
    length = torch.linalg.vector_norm(entity.rot, dim=-1)
    require(
        bool(((length - 1.0).abs() < 1e-6).all()),
        f"rot of '{name}' is no unit quaternion (w, x, y, z): its length is {float(length[0]):.3f}.",
    )


def _check_joints(robot, entity: EntityState) -> None:
    """Checks that a robot starts within the limits of its joints."""
    low, high = torch.tensor([joint.range for joint in robot.joints], dtype=torch.float64).T
    count = len(robot.joints)
    require(
        tuple(entity.joint_pos.shape) == (_NUM_STARTS, count),
        f"joint_pos of '{robot.name}' has the shape {tuple(entity.joint_pos.shape)}; it must be "
        f"{(_NUM_STARTS, count)}: {', '.join(robot.joint_names)}.",
    )
    outside = (entity.joint_pos < low - _SOFT_RAD) | (entity.joint_pos > high + _SOFT_RAD)
    names = [robot.joint_names[column] for column in outside.any(0).nonzero()[:, 0]]
    require(not names, f"'{robot.name}' starts outside the limits of {', '.join(names)}. Clip its start.")


@contract("scene")
def not_finite(checked: CheckedTask) -> str:
    """A state that is not finite is no success."""
    flat = checked.env.get_states().flatten()
    state = State.unflatten({key: torch.full_like(value, torch.nan) for key, value in flat.items()})
    require(
        not bool(checked.task.success(state).any()),
        "success is true for a state of NaN, which a simulation that blew up has. Compare so that NaN is "
        "False: write (error < limit) and not ~(error > limit).",
    )
    return "NaN is no success"
