"""``python roboverse_learn/conservation.py``: tests the conservation laws on each simulator."""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` or `run` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import logging
from collections.abc import Iterator
from typing import Any

from roboverse_learn.config.schema import ConservationConfig

log = logging.getLogger(__name__)


def conservation(config: ConservationConfig) -> Any:
    """Runs the experiments on every simulator, writes table and plots; returns a printable report.

    Raises:
        MissingExtraError: A simulator that was named is not installed.
        ResultError: A JSON file of the folder is not such a result.
        WriteError: A file cannot be written.
    """
    from roboverse_learn.commands.report import conservation_report
    from roboverse_learn.sim2sim.conservation.conservation_page import table, write_page, write_result

    folder = Path(config.out)
    results = [run_on(simulator, config.timestep_s) for simulator in _chosen(config)]
    for result in results:
        write_result(folder, result)
    return conservation_report(table(results), write_page(folder))


def run_on(simulator: str, timestep_s: float) -> dict[str, Any]:
    """Runs every experiment on a simulator; returns plain JSON values."""
    from benchmark.provenance import package_versions
    from envs.core.errors import RoboVerseError
    from roboverse_learn.sim2sim.conservation.experiments import EXPERIMENTS, deviations, run

    found: dict[str, Any] = {}
    for experiment in EXPERIMENTS:
        log.info("%s: %s", simulator, experiment.name)
        try:
            seconds, quantities = run(experiment, simulator, timestep_s)
        except RoboVerseError as error:
            found[experiment.name] = {"error": str(error)}
            continue
        values = deviations(quantities) | {"seconds": seconds}
        found[experiment.name] = {
            name: [float(f"{value:.6g}") for value in series] for name, series in values.items()
        }
    return {
        "simulator": simulator,
        "timestep_s": timestep_s,
        "versions": package_versions(),
        "experiments": found,
    }


def _chosen(config: ConservationConfig) -> Iterator[str]:
    """Yields the named simulators, or all that are installed."""
    from envs.core.errors import MissingExtraError
    from envs.simulators import HANDLERS

    for name in config.simulators or HANDLERS.names():
        try:
            HANDLERS.get(name)
        except MissingExtraError as error:
            if config.simulators:
                raise
            log.info("Left out: %s", error)
            continue
        yield name


if __name__ == "__main__":
    from roboverse_learn.cli import script

    script("conservation")
