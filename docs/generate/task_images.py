"""The page of tasks, made from the registry, the classes and the experts' counts.

``python -m docs.generate.task_images`` writes ``docs/tasks.md`` and, for each task that has no image yet, a
strip of how an episode begins and how the expert ends it, or where half a second of random actions leads
where there is no expert; ``redraw=[PickCube]`` renders one again. Strips of CALVIN's scene D and of the tasks
that are adapted from Meta-World are small and in their tables; LIBERO has pages of its own.
"""

import inspect
import io
import logging
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.atomic import write_file
from envs.core.errors import ConfigError
from envs.core.registry import Entry
from envs.experts.counts import ExpertCount, read_counts
from envs.tasks import TASKS
from envs.tasks.base import Task

logger = logging.getLogger(__name__)

IMAGE_SIZE, SMALL_SIZE = 256, 128
RANDOM_S = 0.5
"""Duration of random actions shown for a task without an expert."""

MAX_BYTES, SMALL_BYTES = 20_000, 6_000
"""Of a strip: the best JPEG quality that fits is taken."""

_QUALITIES = range(92, 20, -6)


def page(names: Iterable[str] | None = None) -> str:
    """Returns the page in Markdown.

    Args:
        names: The tasks; by default all that are registered. Those of a family are not imported.
    """
    entries = [TASKS.entry(name) for name in (TASKS.names() if names is None else names)]
    counts = read_counts()
    families: dict[str, list[Entry]] = {}
    for entry in entries:
        families.setdefault(entry.info.get("family", ""), []).append(entry)
    parts = [
        "# Tasks",
        "This page is made by `python -m docs.generate.task_images`; `roboverse list` shows the same facts. "
        "Expert success is that of the scripted expert at level 0, in the first episodes of the test split "
        "(`python -m envs.experts.survey`). Images show the start of a training episode and the expert's "
        f"success, or, of a task without an expert, the start and {RANDOM_S:g} s of random actions later.",
    ]
    parts += [section(entry, counts.get(entry.name)) for entry in families.pop("", [])]
    parts += [family_section(name, members, counts) for name, members in families.items()]
    return "\n\n".join(parts) + "\n"


def section(entry: Entry, count: ExpertCount | None) -> str:
    """Returns one task's part of the page."""
    cls = TASKS.get(entry.name)
    task = cls()
    scenario, info = task.scenario, entry.info
    hz = scenario.physics.control_hz
    cameras = ", ".join(f"{camera.name} {camera.width}×{camera.height}" for camera in scenario.cameras)
    module = inspect.getdoc(sys.modules[cls.__module__]) or ""
    rows = {
        "Source": f"{info['source']} ({_paper(info['paper'])}; {info['licence']})",
        "Instructions": "<br>".join(f"“{text}”" for text in task.instructions),
        "Robot": f"{_robots(task)}; an action has {_numbers(task.controller.names)}",
        "Cameras": cameras,
        "Horizon": f"{task.max_episode_steps} steps, {task.max_episode_steps / hz:g} s at {hz:g} Hz",
        "Expert": described(count) if task.has_expert else "none: use reinforcement learning",
        **_bar(task),
        **{f"`task_kwargs.{key}`": text for key, text in options(cls).items()},
    }
    return "\n".join(
        [
            f"## {entry.name}",
            "",
            plain(class_text(cls)),
            "",
            f"![{entry.name}: {_shown(task)}]({image_path(entry.name).as_posix()})",
            "",
            "| | |",
            "|---|---|",
            *(f"| {key} | {plain(value)} |" for key, value in rows.items()),
            "",
            plain(module.partition("\n\n")[2]) or plain(module),
        ]
    )


def _robots(task: Task) -> str:
    return " and ".join(robot.name for robot in task.robots)


def _numbers(names: Sequence[str]) -> str:
    first, last = names[0], names[-1]
    return f"{len(names)} numbers, `{first}` to `{last}`" if len(names) > 1 else f"one number, `{first}`"


def _bar(task: Task) -> dict[str, str]:
    bar = task.success_return
    return {} if bar is None else {"Success": f"a return of {bar:g} or more"}


def _shown(task: Task) -> str:
    return "start and success" if task.has_expert else "start and a little later"


def family_section(name: str, members: Sequence[Entry], counts: Mapping[str, ExpertCount]) -> str:
    """Returns the part of the page of tasks that have one source, robot and horizon: a table."""
    info = members[0].info
    if "robot" in info:  # what is said without the assets
        robot, horizon = info["robot"], info["horizon"]
    else:
        task = TASKS.get(members[0].name)()
        robot, horizon = _robots(task), str(task.max_episode_steps)
    lines = [
        f"## {name}",
        "",
        f"{len(members)} tasks of {info['source']} ({_paper(info['paper'])}; {info['licence']}). "
        f"Robot: {robot}. Horizon: {horizon} steps.{_where_images_are(members)}",
        "",
        "| task | what to do | expert |" + (" start and end |" if any(map(is_small, members)) else ""),
        "|---|---|---|" + ("---|" if any(map(is_small, members)) else ""),
    ]
    lines += [f"| {e.name} | {e.summary} | {described(counts.get(e.name))} |{_in_row(e)}" for e in members]
    shown = [e.name for e in members if is_drawn(e) and not is_small(e)]
    images = [f"{name}:\n\n![{name}: start and success]({image_path(name).as_posix()})" for name in shown]
    return "\n\n".join(["\n".join(lines), *images])


def _where_images_are(members: Sequence[Entry]) -> str:
    """Returns what draws a family's images where none are here; nothing where some are."""
    if any(map(is_drawn, members)):
        return ""
    why = " of objects that may not be shared freely" if "libero" in members[0].tags else ""
    command = f"python -m docs.generate.task_images redraw=[{members[0].name}]"
    return f" Images{why} are not in this repository: `{command}` draws one."


def _in_row(entry: Entry) -> str:
    image = f"![{entry.name}: start and end]({image_path(entry.name).as_posix()})"
    return f" {image} |" if is_small(entry) else ""


def is_drawn(entry: Entry) -> bool:
    """Whether the page shows a task: all but LIBERO's, which are many, and CALVIN's outside of scene D.

    A task tagged ``same_scene`` looks like another one that is shown.
    """
    return is_small(entry) or not {"calvin", "libero", "same_scene"} & entry.tags


def is_small(entry: Entry) -> bool:
    """Whether a task's strip is small and in its family's table."""
    return "adapted" in entry.tags or entry.name.startswith("calvin/D/")


def described(count: ExpertCount | None) -> str:
    """Returns a count in words."""
    return "not measured" if count is None else f"{count}, {count.mean_steps:.1f} steps"


def class_text(cls: type[Task]) -> str:
    """Returns a class's docstring without its sections."""
    return (inspect.getdoc(cls) or "").partition("\n\nAttributes:")[0]


def options(cls: type[Task]) -> dict[str, str]:
    """Returns the options of a task, its dataclass's fields, with what its docstring says of each.

    A field of a base class is described there.
    """
    found: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        text = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        found |= dict(re.findall(r"^ {4}(\w+): (.+(?:\n {8,}.+)*)", text, re.MULTILINE))
    fields = getattr(cls, "__dataclass_fields__", {})
    return {
        name: f"{found.get(name, '')} Default: `{_shown_value(field.default)}`{_limits(field.metadata)}."
        for name, field in fields.items()
        if field.init and "ClassVar" not in str(field.type)
    }


def _shown_value(value: Any) -> str:
    """Returns a value as it is typed, numbers in four digits."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_shown_value, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _limits(metadata: Mapping[str, Any]) -> str:
    return f"; {metadata['bounds']}" if "bounds" in metadata else ""


def plain(text: str) -> str:
    """Returns Markdown from a docstring: paragraphs in one line each, Sphinx roles as code."""
    text = re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text).replace("``", "`")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in text.split("\n\n") if paragraph.strip())


def _paper(reference: str) -> str:
    number = reference.removeprefix("arXiv:")
    return f"[{reference}](https://arxiv.org/abs/{number})"


def image_path(name: str) -> Path:
    """Returns the path of a task's strip, from the folder of the page."""
    return Path("tasks") / f"{name.replace('/', '_')}.jpg"


def draw_strip(name: str, *, renderer: str = "warp") -> np.ndarray:
    """Returns the first camera's images of how an episode begins and ends, (H, 2 W, 3) uint8.

    It is the first training episode that the expert solves; of a task that has none, the first, and its end
    is where random actions lead in :data:`RANDOM_S`.

    Raises:
        ConfigError: if the expert solves none of the first ten.
    """
    return _drawn(name, renderer, _solved(name) if TASKS.get(name).has_expert else None)


def _solved(name: str) -> tuple[int, np.ndarray]:
    """Returns an episode that the expert solves, and its actions up to there."""
    from envs.experts.actor import expert_episodes
    from envs.spec import EnvSpec
    from envs.tasks.plan_following import TAIL_STEPS

    states = EnvSpec(task=name).make(observation="state", num_threads=1)
    try:
        episodes = states.split_indices[:10].tolist()
        solved = next((r for r in expert_episodes(states, episodes, record=()) if r.success), None)
    finally:
        states.close()
    if solved is None:
        raise ConfigError(f"The expert of {name} solves none of the episodes {episodes}: nothing to show.")
    return solved.episode, solved.actions[:-TAIL_STEPS]


def _drawn(name: str, renderer: str, solution: tuple[int, np.ndarray] | None) -> np.ndarray:
    """Returns the images before and after an episode's actions; by default random ones in the first."""
    from envs.spec import EnvSpec

    size = SMALL_SIZE if is_small(TASKS.entry(name)) else IMAGE_SIZE
    env = EnvSpec(task=name, image_size=size, renderer=renderer).make(num_threads=1)
    try:
        only = np.array([0])
        if solution is None:
            low, high = env.controller.low, env.controller.high
            steps = round(RANDOM_S * env.control_hz)
            solution = env.split_indices[0], np.random.default_rng(0).uniform(low, high, (steps, len(low)))
        episode, actions = solution
        env.reset_envs(only, np.array([episode]))
        start = _first_image(env)
        for action in actions:
            env.step_envs(only, action[None])
        return np.concatenate([start, _first_image(env)], axis=1)
    finally:
        env.close()


def _first_image(env) -> np.ndarray:
    observation = env.observe(np.array([0]))
    return next(
        np.array(images[0]) for key, images in observation.items() if key.startswith("observation.images.")
    )


def encode(strip: np.ndarray) -> bytes:
    """Returns a strip as JPEG of at most :data:`MAX_BYTES`, or :data:`SMALL_BYTES`, as good as fits."""
    from PIL import Image

    content = b""
    for quality in _QUALITIES:
        stream = io.BytesIO()
        Image.fromarray(strip).save(stream, format="JPEG", quality=quality, optimize=True)
        content = stream.getvalue()
        if len(content) <= (MAX_BYTES if len(strip) > SMALL_SIZE else SMALL_BYTES):
            break
    return content


def write(path: Path, content: bytes) -> None:
    """Writes a file and says how large it is."""
    write_file(path, content)
    logger.info("%s: %d bytes", path, len(content))


@dataclass(frozen=True, kw_only=True, slots=True)
class GallerySettings:
    """Settings of the program.

    Attributes:
        out: Folder of ``tasks.md``.
        redraw: Tasks to render again: ``[PickCube,CloseBox]``.
        renderer: Name of a renderer.
    """

    out: Path = Path("docs")
    redraw: tuple[str, ...] = ()
    renderer: str = "warp"


def main(words: Sequence[str] | None = None) -> int:
    """Writes the page of tasks and the images that it lacks; returns the exit code."""
    return run_program("python -m docs.generate.task_images", GallerySettings, _write_all, words)


def _write_all(args: GallerySettings) -> None:
    for name in args.redraw:
        TASKS.entry(name)
    write(args.out / "tasks.md", page().encode())
    for name in TASKS.names():
        path = args.out / image_path(name)
        if name in args.redraw or (is_drawn(TASKS.entry(name)) and not path.is_file()):
            write(path, encode(draw_strip(name, renderer=args.renderer)))


if __name__ == "__main__":
    sys.exit(main())
