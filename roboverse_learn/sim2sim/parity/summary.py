"""Summaries of replays as JSON values: one file per task and pair of simulators."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from envs.core.errors import ConfigError
from envs.scenario import ScenarioCfg
from roboverse_learn.data.dataset.recording import Recording
from roboverse_learn.sim2sim.parity.drift import UNITS, drift, over_time
from roboverse_learn.sim2sim.parity.tracks import Track
from roboverse_learn.sim2sim.result_files import read_json_results, write_json_result

SCHEMA_VERSION = 1

FAR_M = 0.01
"""Distance from its recorded position from which on an object counts as displaced, m."""

_KEYS = {"schema_version", "task", "recorded_in", "replayed_in", "num_episodes", "replays", "control_hz"}


def summarize(
    scenario: ScenarioCfg,
    recordings: Sequence[Recording],
    tracks: Sequence[Track],
    recorded: Sequence[np.ndarray],
) -> dict[str, Any]:
    """Compares replays with their recordings.

    Args:
        scenario: Their scene.
        recordings: Episodes.
        tracks: The replay of each.
        recorded: Success of each one's recorded states, bool (T + 1,).

    Returns:
        ``success_rate``, ``recorded_success_rate``, ``checks`` (how many states the success condition judged,
        and how many of them it judged as in the recording), ``drift`` (quantity to curves over time, and to
        the median and 90th percentile at the end), ``far_after_s`` (for each episode, when an object was
        first more than :data:`FAR_M` away, or None) and ``episodes``.
    """
    curves = [
        drift(scenario, recording.states, track.states)
        for recording, track in zip(recordings, tracks, strict=True)
    ]
    hz = scenario.physics.control_hz
    same = [then == now[: len(then)] for then, now in zip(recorded, (t.success for t in tracks), strict=True)]
    return {
        "success_rate": float(np.mean([track.solved for track in tracks])),
        "recorded_success_rate": float(np.mean([then.any() for then in recorded])),
        "checks": {"asked": int(sum(map(len, same))), "agree": int(sum(map(np.sum, same)))},
        "drift": {
            name: {
                "over_time": over_time([curve[name] for curve in curves]),
                "last": _spread([curve[name][-1] for curve in curves]),
                "largest": float(max(curve[name].max() for curve in curves)),
            }
            for name in UNITS
            if name in curves[0]
        },
        "far_after_s": [_first_far(curve, hz) for curve in curves],
        "episodes": [
            {
                "index": recording.index,
                "episode": int(recording.metadata["episode"]),
                "recorded": bool(then.any()),
                "replayed": track.solved,
            }
            for recording, track, then in zip(recordings, tracks, recorded, strict=True)
        ],
    }


def _spread(values: Sequence[float]) -> dict[str, float]:
    return {"median": float(np.median(values)), "p90": float(np.percentile(values, 90))}


def _first_far(curve: Mapping[str, np.ndarray], control_hz: float) -> float | None:
    if "objects_m" not in curve:
        return None
    far = np.flatnonzero(curve["objects_m"] > FAR_M)
    return float(far[0] / control_hz) if len(far) else None


def file_name(summary: Mapping[str, Any]) -> str:
    """Returns the name of a summary's file, without its suffix."""
    options = [f"{key}={value}" for key, value in sorted(summary.get("task_kwargs", {}).items())]
    parts = [summary["task"], *options, summary["recorded_in"], "to", summary["replayed_in"]]
    return re.sub(r"[^A-Za-z0-9._+=-]+", "_", "-".join(parts))


def refuse_to_replace(folder: Path, summary: Mapping[str, Any]) -> None:
    """Checks that the file of a summary does not hold that of another dataset.

    Args:
        folder: Folder of summaries.
        summary: What :func:`file_name` needs, ``dataset``, and ``first_actions_hash`` of its first episode; a
            summary without them is of an earlier version and may be replaced.

    Raises:
        ConfigError: It does.
    """
    path = folder / f"{file_name(summary)}.json"
    try:
        there = json.loads(path.read_bytes())
        other, first = there["dataset"], there["first_actions_hash"]
    except (OSError, ValueError, KeyError, TypeError):
        return  # there is none, or the page will name what is wrong with it
    given = summary["dataset"]
    if first != summary["first_actions_hash"] and Path(other).resolve() != Path(given).resolve():
        raise ConfigError(
            f"'{path}' is of the replay of dataset={other}, and that of dataset={given} would take its "
            f"place. Add out={folder / Path(given).resolve().name} to write beside it, or move the file away."
        )


def write(folder: Path, summary: Mapping[str, Any]) -> Path:
    """Writes a summary into a folder; returns its file.

    Raises:
        WriteError: The file cannot be written.
    """
    path = folder / f"{file_name(summary)}.json"
    write_json_result(path, summary)
    return path


def read_all(folder: Path) -> list[dict[str, Any]]:
    """Reads every summary of a folder, ordered by task and pair of simulators.

    Raises:
        ResultError: A file is no summary.
    """
    return read_json_results(folder, _KEYS, "summary of a replay")
