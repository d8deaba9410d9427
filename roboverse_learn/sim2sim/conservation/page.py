"""The page of conservation: one JSON file per simulator, a table and three plots made of them alone."""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.leaderboard.plots import COLORS, new_figure, save_figure
from envs.core.atomic import write_file
from envs.core.errors import ResultError
from roboverse_learn.sim2sim.conservation.experiments import EXPERIMENTS, Experiment

PAGE_NAME = "conservation.md"

QUANTITIES = {
    "momentum": "momentum",
    "angular_momentum": "angular momentum",
    "kinetic_energy": "kinetic energy",
}

_LEAST_SHOWN = 1e-16
_WIDEST_LINE = 5.0
"""Points; simulators that agree lie on each other, so each line is thinner than the one below it."""

_KEYS = {"simulator", "timestep_s", "experiments"}


def write_result(folder: Path, result: Mapping[str, Any]) -> Path:
    """Writes what one simulator came to; returns its file.

    Raises:
        ResultError: The file cannot be written.
    """
    path = folder / f"{result['simulator']}.json"
    text = json.dumps(result, indent=1, sort_keys=True, allow_nan=False)
    text = re.sub(r"\[\s+([-\d.e,\s]+?)\s+\]", lambda m: "[" + " ".join(m[1].split()) + "]", text)
    write_file(path, (text + "\n").encode())
    return path


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Reads the files of a folder, by simulator.

    Raises:
        ResultError: A file is none of ours.
    """
    results = []
    for path in sorted(folder.glob("*.json")):
        try:
            values = json.loads(path.read_bytes())
        except ValueError as error:
            raise ResultError(f"'{path}' is no JSON file: {error}. Remove it and run again.") from error
        if not isinstance(values, dict) or not set(values) >= _KEYS:
            raise ResultError(
                f"'{path}' is no result of roboverse conservation. Keep other files out of '{folder}', or "
                "choose another folder with out=<folder>."
            )
        results.append(values)
    return results


def write_page(folder: Path) -> dict[str, Path]:
    """Writes the table and the three plots; returns what was written.

    Raises:
        ResultError: A file of the folder is none of ours, or one cannot be written.
    """
    results = read_results(folder)
    written = {"table": folder / PAGE_NAME}
    for name in QUANTITIES:
        written[f"plot {name}"] = folder / f"{name}.png"
        plot(results, name, written[f"plot {name}"])
    write_file(written["table"], render(results).encode())
    return written


def render(results: Sequence[Mapping[str, Any]]) -> str:
    """Returns the page in Markdown."""
    head = ["experiment", "simulator", "time step", *QUANTITIES.values()]
    lines = [
        "# Conservation laws",
        "",
        "This page is made by `roboverse conservation` from the JSON files beside it: scenes without gravity "
        "and without a robot, each run through the handler of every simulator that is installed. In "
        "**collision** a ball hits another off its centre; **spin** is a box that turns about its middle "
        "axis; **chain** has three links on two hinges without damping. Momentum, angular momentum and "
        "kinetic energy are worked out from the states and the description of the objects alone. Numbers "
        "are the largest deviation from the start, relative to it; a collision may lose kinetic energy, so "
        "there it is what is left of it at the end.",
        "",
        "| " + " | ".join(head) + " |",
        "|" + "---|" * len(head),
        *(_row(each, result) for each in EXPERIMENTS for result in results),
    ]
    for result in results:
        failed = {name: value["error"] for name, value in result["experiments"].items() if "error" in value}
        lines += [f"\n{result['simulator']} did not run {name}: {error}" for name, error in failed.items()]
    for name, title in QUANTITIES.items():
        lines += ["", f"## {title.capitalize()}", "", f"![{title}]({name}.png)"]
    return "\n".join(lines) + "\n"


def _row(experiment: Experiment, result: Mapping[str, Any]) -> str:
    cells = [experiment.name, result["simulator"], f"{1000 * result['timestep_s']:g} ms"]
    found = result["experiments"].get(experiment.name, {})
    for name in QUANTITIES:
        if name not in found:
            cells.append("not run")
        elif name == "kinetic_energy" and not experiment.keeps_energy:
            cells.append(f"{100 * (1 + found[name][-1]):.1f} % left")
        else:
            cells.append(f"{np.abs(found[name]).max():.1e}")
    return "| " + " | ".join(cells) + " |"


def plot(results: Sequence[Mapping[str, Any]], name: str, path: Path) -> None:
    """Draws the deviation of one quantity over time, one panel per experiment, one line per simulator.

    Raises:
        ResultError: The file cannot be written.
    """
    figure, axes = new_figure((10.0, 3.0), len(EXPERIMENTS))
    for each, experiment in zip(axes, EXPERIMENTS, strict=True):
        for number, (result, color) in enumerate(zip(results, COLORS, strict=False)):
            found = result["experiments"].get(experiment.name, {})
            if name in found:
                values = np.maximum(np.abs(found[name]), _LEAST_SHOWN)
                width = _WIDEST_LINE * (1.0 - number / (len(results) + 1))
                each.plot(found["seconds"], values, color=color, linewidth=width, label=result["simulator"])
        each.set(xlabel="time, s", yscale="log", ylim=(_LEAST_SHOWN, 10.0))
        each.set_title(experiment.name, fontsize=9, loc="left")
    axes[0].set_ylabel("relative deviation")
    if axes[0].get_lines():
        figure.legend(
            *axes[0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=len(results),
            frameon=False,
            fontsize=8,
        )
    figure.suptitle(f"{QUANTITIES[name].capitalize()} without gravity", fontsize=10)
    save_figure(figure, path)
