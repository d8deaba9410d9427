"""What a dataset holds, in lines: its scenes, what made it, what a policy sees and does, its instructions."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from envs.core.observation_keys import IMAGE_PREFIX
from roboverse_learn.checks.contract import counted
from roboverse_learn.data.dataset.schema import ACTION_KEY, STATE_KEY

if TYPE_CHECKING:
    from roboverse_learn.data import DatasetInfo

_OF_ALL = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns of every dataset of LeRobot's format."""

_MOST = 12
"""Scenes, names or instructions that are shown; a dataset may have hundreds."""


def contents(info: "DatasetInfo") -> list[str]:
    """Returns the lines. What a dataset of another program does not say is left out."""
    scenes = Counter(_scene(each, info.robot_type) for each in info.episode_metadata)
    lines = [f"{counted(count, 'episode')} of {scene}" for scene, count in scenes.most_common(_MOST) if scene]
    if len(scenes) > _MOST:
        lines.append(f"… and {len(scenes) - _MOST} further scenes")
    for key, what in ((STATE_KEY, "state"), (ACTION_KEY, "action")):
        if key in info.features:
            lines.append(f"{what}: {_numbers(info.features[key])}")
    images = [
        f"{key.removeprefix(IMAGE_PREFIX)} of {info.shapes[key][1]} × {info.shapes[key][0]} pixels"
        for key in info.camera_keys
    ]
    lines.append(f"cameras: {', '.join(images) or 'none'}")
    further = [
        key for key in info.features if key not in (STATE_KEY, ACTION_KEY, *info.camera_keys, *_OF_ALL)
    ]
    lines += [f"further columns: {_some(further)}"] if further else []
    return [*lines, f"instructions: {_some(info.tasks, '; ')}"]


def _scene(metadata: Mapping[str, Any], robot_type: str | None) -> str:
    """Describes the scene of an episode and what made it; empty where it names no task."""
    if "task" not in metadata:
        return ""
    robot = metadata.get("robot") or robot_type
    varied = f"only {metadata['only']}" if metadata.get("only") else ""
    varied = f"level {metadata['level']}" if metadata.get("level") is not None else varied
    options = "".join(f" {key}={value}" for key, value in (metadata.get("task_kwargs") or {}).items())
    renderer, simulator = metadata.get("renderer"), metadata.get("simulator")
    parts = [
        f"{metadata['task']}{options}" + (f" with {robot}" if robot else ""),
        varied,
        f"{metadata['split']} split" if metadata.get("split") else "",
        f"simulated by {simulator}" if simulator else "",
        f"rendered by {renderer}" if renderer else "",
        _source(metadata),
    ]
    return ", ".join(part for part in parts if part)


def _source(metadata: Mapping[str, Any]) -> str:
    """Says what an episode was made from, where it was not acted in the scene."""
    if robot := metadata.get("source_robot"):
        return f"retargeted from {robot}"
    if "look" in metadata:
        return "rendered again"
    source = str(metadata.get("source") or "")
    return {"": "", "augment": "augmented", "teleop": "teleoperated"}.get(source, f"from {source}")


def _numbers(feature: Mapping[str, Any]) -> str:
    names = feature.get("names")
    named = f" ({_some(names)})" if isinstance(names, Sequence) and not isinstance(names, str) else ""
    return f"{feature['shape'][0]} numbers{named}"


def _some(texts: Sequence[str], between: str = ", ") -> str:
    more = f"{between}… and {len(texts) - _MOST} more" if len(texts) > _MOST else ""
    return between.join(map(str, texts[:_MOST])) + more
