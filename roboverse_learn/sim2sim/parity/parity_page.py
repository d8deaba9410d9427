"""The page of replays across simulators: a table and plots, a pure function of a folder's summaries."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.leaderboard.plots import COLORS, new_figure, save_figure
from envs.core.atomic import write_file
from envs.playback import HOLD_STEPS
from roboverse_learn.sim2sim.parity.summary import FAR_M, file_name, read_all

PAGE_NAME = "parity.md"

_HEAD = (
    "task",
    "recorded in",
    "replayed in",
    "episodes",
    "success by states",
    "checks that agree",
    "end effector by states, largest",
    "success by controls",
    "end effector at the end",
    "objects at the end",
    "an object is off by 1 cm",
)

_SHOWN = {
    "end_effector_m": ("end effector, mm", 1000.0),
    "objects_m": ("farthest object, mm", 1000.0),
    "object_joints": ("farthest joint of an object, rad or m", 1.0),
}

_LEAST_SHOWN = 1e-6
"""Lower end of the axes of drift, mm or rad; the curve of an exact replay is on it."""


def write_page(folder: Path) -> dict[str, Path]:
    """Writes the table, and the plot of every summary that was replayed by controls.

    Returns:
        The written files: ``table``, and ``plot <name>`` for each plot.

    Raises:
        ResultError: A JSON file of the folder is no summary.
        WriteError: A file cannot be written.
    """
    summaries = read_all(folder)
    written = {"table": folder / PAGE_NAME}
    for summary in summaries:
        if "controls" in summary["replays"]:
            name = file_name(summary)
            written[f"plot {name}"] = folder / f"{name}.png"
            plot(summary, written[f"plot {name}"])
    write_file(written["table"], render(summaries).encode())
    return written


def render(summaries: Sequence[Mapping[str, Any]]) -> str:
    """Returns the page in Markdown."""
    rows = [_row(summary) for summary in summaries]
    lines = [
        "# Replays across simulators",
        "",
        "This page is made by `roboverse replay dataset=… simulator=…` from the JSON files beside it. "
        "**By states**, every recorded state is set in the other simulator and read back. Success, and how "
        "often the success condition agrees with the recording, show whether states, kinematics and the "
        "condition mean the same there. **By controls**, the first state is set and the recorded actions are "
        f"given, the last of them for {HOLD_STEPS} more steps: physics decides. Drift is the median over the "
        "episodes, with the 90th percentile in brackets, of the object or object joint that drifts farthest. "
        f"The last column counts the episodes in which an object was ever {1000 * FAR_M:.0f} mm from its "
        "recorded position, with the median time at which it first was.",
        "",
        "| " + " | ".join(_HEAD) + " |",
        "|" + "---|" * len(_HEAD),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]
    for summary in summaries:
        if summary.get("note"):
            lines += ["", f"**{_title(summary)}**: {summary['note']}"]
    for summary in summaries:
        name = file_name(summary)
        if "controls" in summary["replays"]:
            lines += ["", f"## {_title(summary)}", "", f"![{name}]({name}.png)"]
        if summary.get("command"):
            lines += ["", f"`{summary['command']}`"]
    return "\n".join(lines) + "\n"


def _title(summary: Mapping[str, Any]) -> str:
    options = ", ".join(f"{k}={v}" for k, v in sorted(summary.get("task_kwargs", {}).items()))
    task = f"{summary['task']} ({options})" if options else summary["task"]
    return f"{task}, {summary['recorded_in']} → {summary['replayed_in']}"


def _row(summary: Mapping[str, Any]) -> tuple[str, ...]:
    states, controls = (summary["replays"].get(kind) for kind in ("states", "controls"))
    none = "not replayed"
    by_states = (none, "", "")
    if states is not None:
        checks = states["checks"]
        by_states = (
            _percent(states["success_rate"]),
            f"{checks['agree']} of {checks['asked']}",
            _length(states["drift"]["end_effector_m"]["largest"]),
        )
    by_controls = (none, "", "", "")
    if controls is not None:
        far = [after for after in controls["far_after_s"] if after is not None]
        by_controls = (
            _percent(controls["success_rate"]),
            _at_the_end(controls["drift"], ("end_effector_m",)),
            _at_the_end(controls["drift"], ("objects_m", "object_joints")),
            f"{len(far)} of {summary['num_episodes']}" + (f", after {np.median(far):.2f} s" if far else ""),
        )
    title, pair = _title(summary).rsplit(", ", 1)
    recorded, replayed = pair.split(" → ")
    return (title, recorded, replayed, str(summary["num_episodes"]), *by_states, *by_controls)


def _at_the_end(found: Mapping[str, Any], names: Sequence[str]) -> str:
    cells = []
    for name in names:
        if name in found:
            shown = _length if name.endswith("_m") else _joint
            last = found[name]["last"]
            cells.append(f"{shown(last['median'])} ({shown(last['p90'])})")
    return ", ".join(cells) or "none"


def _percent(rate: float) -> str:
    return f"{100 * rate:.0f} %"


def _length(metres: float) -> str:
    """Returns a length in mm, or in µm if it is short."""
    if metres == 0.0:
        return "0"
    return f"{1000 * metres:.2g} mm" if metres >= 1e-5 else f"{1e6 * metres:.2g} µm"


def _joint(radians: float) -> str:
    return f"{radians:.1e} rad" if radians else "0"


def plot(summary: Mapping[str, Any], path: Path) -> None:
    """Plots the drift of a replay by controls over time: median and 90th percentile.

    Raises:
        WriteError: The file cannot be written.
    """
    found = summary["replays"]["controls"]["drift"]
    shown = [name for name in _SHOWN if name in found]
    figure, axes = new_figure((3.4 * max(2, len(shown)), 3.0), max(2, len(shown)))
    for each in axes[len(shown) :]:
        each.set_visible(False)
    for each, name, color in zip(axes, shown, COLORS, strict=False):
        title, scale = _SHOWN[name]
        median, p90 = (
            np.maximum(scale * np.array(found[name]["over_time"][kind]), _LEAST_SHOWN)
            for kind in ("median", "p90")
        )
        seconds = np.arange(len(median)) / summary["control_hz"]
        each.fill_between(seconds, median, p90, color=color, alpha=0.2, linewidth=0, label="to 90 %")
        each.plot(seconds, median, color=color, linewidth=1.8, label="median")
        each.set(xlabel="time, s", yscale="log", ylim=(_LEAST_SHOWN / 2, None))
        each.set_title(title, fontsize=9, loc="left")
    axes[0].legend(frameon=False, fontsize=8)
    rate = summary["replays"]["controls"]["success_rate"]
    figure.suptitle(f"{_title(summary)}, by controls: {_percent(rate)} success", fontsize=10)
    save_figure(figure, path)
