"""The page of conservation laws: a table and three plots, made from one JSON file per simulator."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.leaderboard.plots import COLORS, new_figure, save_figure
from envs.core.atomic import write_file
from roboverse_learn.sim2sim.conservation.experiments import EXPERIMENTS, Experiment
from roboverse_learn.sim2sim.result_files import read_json_results, write_json_result

PAGE_NAME = "conservation.md"

QUANTITIES = {
    "momentum": "momentum",
    "angular_momentum": "angular momentum",
    "kinetic_energy": "kinetic energy",
}

_LEAST_SHOWN = 1e-16
_WIDEST_LINE = 5.0
"""Points. Lines of simulators that agree overlap, so each is thinner than the one below it."""

_KEYS = {"simulator", "timestep_s", "experiments"}


def write_result(folder: Path, result: Mapping[str, Any]) -> None:
    """Writes the result of one simulator.

    Raises:
        WriteError: The file cannot be written.
    """
    write_json_result(folder / f"{result['simulator']}.json", result)


def write_page(folder: Path) -> dict[str, Path]:
    """Writes the table and the three plots; returns what was written.

    Raises:
        ResultError: A JSON file of the folder is not such a result.
        WriteError: A file cannot be written.
    """
    results = read_json_results(folder, _KEYS, "result of roboverse conservation")
    written = {"table": folder / PAGE_NAME}
    for name in QUANTITIES:
        written[f"plot {name}"] = folder / f"{name}.png"
        plot(results, name, written[f"plot {name}"])
    write_file(written["table"], render(results).encode())
    return written


def render(results: Sequence[Mapping[str, Any]]) -> str:
    """Returns the page in Markdown."""
    head, *rows = ("| " + " | ".join(cells) + " |" for cells in table(results))
    lines = [
        "# Conservation laws",
        "",
        "This page is made by `roboverse conservation` from the JSON files beside it: scenes without gravity "
        "and without a robot, run on every installed simulator. In **collision** a ball hits another one off "
        "its centre. **spin** is a box that turns about its middle axis of inertia. **chain** has three "
        "links on two hinges without damping. Momentum, angular momentum and kinetic energy are computed "
        "from the states and the description of the objects. Numbers are the largest deviation from the "
        "start, relative to it. A collision may lose kinetic energy; its share at the end is shown.",
        "",
        head,
        "|" + "---|" * (head.count("|") - 1),
        *rows,
    ]
    for result in results:
        failed = {name: value["error"] for name, value in result["experiments"].items() if "error" in value}
        lines += [f"\n{result['simulator']} did not run {name}: {error}" for name, error in failed.items()]
    for name, title in QUANTITIES.items():
        lines += ["", f"## {title.capitalize()}", "", f"![{title}]({name}.png)"]
    return "\n".join(lines) + "\n"


def table(results: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Returns the head of the table, and a row of cells for each experiment on each simulator."""
    head = ["experiment", "simulator", "time step", *QUANTITIES.values()]
    return [head, *(_row(each, result) for each in EXPERIMENTS for result in results)]


def _row(experiment: Experiment, result: Mapping[str, Any]) -> list[str]:
    cells = [experiment.name, result["simulator"], f"{1000 * result['timestep_s']:g} ms"]
    found = result["experiments"].get(experiment.name, {})
    for name in QUANTITIES:
        if name not in found:
            cells.append("not run")
        elif name == "kinetic_energy" and not experiment.keeps_energy:
            cells.append(f"{100 * (1 + found[name][-1]):.1f} % left")
        else:
            cells.append(f"{np.abs(found[name]).max():.1e}")
    return cells


def plot(results: Sequence[Mapping[str, Any]], name: str, path: Path) -> None:
    """Draws the deviation of one quantity over time, one panel per experiment, one line per simulator.

    Raises:
        WriteError: The file cannot be written.
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
