"""Drift of a replay from the recording, state by state.

Shape legend: E = episodes, T = states of the longest of them.
"""

from collections.abc import Sequence

import numpy as np
import torch

from envs.scenario import ScenarioCfg
from envs.state import State

UNITS = {
    "end_effector_m": "m",
    "objects_m": "m",
    "objects_rad": "rad",
    "object_joints": "rad or m",
}
"""Quantities and their units: distance of the end effector, largest distance and angle of any free object,
and largest difference of any joint of an articulated object."""


def drift(scenario: ScenarioCfg, recorded: State, replayed: State) -> dict[str, np.ndarray]:
    """Compares two states row by row.

    Args:
        scenario: Their scene.
        recorded: Recorded states, T rows.
        replayed: Replayed states, T rows.

    Returns:
        Quantity of :data:`UNITS` to its values (T,), those that the scenario has.
    """
    values: dict[str, list[torch.Tensor]] = {name: [] for name in UNITS}
    for robot in scenario.robots:
        ours, theirs = recorded.robots[robot.name].ee_pos, replayed.robots[robot.name].ee_pos
        assert ours is not None and theirs is not None, "a simulator gives every robot's end effector"
        values["end_effector_m"].append(_distance(ours, theirs))
    for item in scenario.objects:
        ours, theirs = recorded.objects[item.name], replayed.objects[item.name]
        if item.kind == "free":
            values["objects_m"].append(_distance(ours.pos, theirs.pos))
            values["objects_rad"].append(_angle(ours.rot, theirs.rot))
        if item.joint_names:
            apart = (ours.joint_pos.double() - theirs.joint_pos.double()).abs()
            values["object_joints"].append(apart.amax(dim=1))
    return {name: torch.stack(parts).amax(dim=0).numpy() for name, parts in values.items() if parts}


def _distance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a.double() - b.double()).norm(dim=-1)


def _angle(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """Returns the angles (T,) between orientations (T, 4), in [0, π]; exact for small ones."""
    a, b = (q.double() / q.double().norm(dim=-1, keepdim=True) for q in (a, b))
    # |a - b| = 2 sin(θ/4): unlike the arc cosine of the product, this loses nothing near zero.
    apart = torch.minimum((a - b).norm(dim=-1), (a + b).norm(dim=-1))
    return 4.0 * torch.asin((apart / 2.0).clamp(max=1.0))


def over_time(series: Sequence[np.ndarray]) -> dict[str, list[float]]:
    """Returns median and 90th percentile over the episodes, for each step that half of them reach.

    Args:
        series: Values (T_e,) of each episode.

    Returns:
        ``median`` and ``p90``, each of equal length.
    """
    length = int(np.median([len(values) for values in series]))
    table = np.full((len(series), length), np.nan)  # (E, T)
    for row, values in zip(table, series, strict=True):
        row[: len(values)] = values[:length]
    return {
        "median": [float(value) for value in np.nanmedian(table, axis=0)],
        "p90": [float(value) for value in np.nanpercentile(table, 90, axis=0)],
    }
