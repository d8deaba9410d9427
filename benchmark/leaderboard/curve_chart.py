"""SVG coordinates of the learning curves on the leaderboard page."""

from collections.abc import Mapping, Sequence
from typing import Any

from benchmark.leaderboard.plots import COLORS, LESS_WHEN_SOLVED, check_number, seeds_and_time
from benchmark.learning_curves import published

_WIDTH, _HEIGHT = 560, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 20, 16, 40
_TITLES = {"episode_return": "return of an episode", "success_rate": "success in training, with exploration"}


def curve_charts(
    task: str, curves: Sequence[Mapping[str, Any]], *, ends_when_solved: bool = False
) -> list[dict[str, Any]]:
    """Returns one chart per measure, of learning curves of a section, eight at most; none without any.

    Args:
        task: Task of the section; returns that others published of it are marked.
        curves: From :func:`benchmark.leaderboard.curves_section.learning_curves`.
        ends_when_solved: Whether a solved episode is over; the title says then why the return falls.

    Raises:
        ValueError: There are more curves than colours.
    """
    if not curves:
        return []
    check_number(curves)
    returns = _chart("episode_return", curves, published(task))
    if ends_when_solved:
        returns["title"] += f" ({LESS_WHEN_SOLVED})"
    return [returns, _chart("success_rate", curves, [])]


def _chart(
    name: str, curves: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    values = [v for curve in curves for v in _ends(curve[name])] + [o["episode_return"] for o in others]
    low, high = (0.0, 1.0) if name == "success_rate" else (min([0.0, *values]), max(values))
    high = high if high > low else low + 1.0
    farthest = max([curve["steps"][-1] for curve in curves] + [o["steps"] for o in others])

    def x(step: float) -> float:
        return round(_LEFT + step / farthest * (_WIDTH - _LEFT - _RIGHT), 1)

    def y(value: float) -> float:
        return round(_TOP + (high - value) / (high - low) * (_HEIGHT - _TOP - _BOTTOM), 1)

    lines = []
    for curve, color in zip(curves, COLORS, strict=False):
        measure = curve[name]
        across = [x(step) for step in curve["steps"]]
        band = []
        if measure["low"] is not None:
            there = list(zip(across, map(y, measure["high"]), strict=True))
            back = list(zip(across, map(y, measure["low"]), strict=True))
            band = there + back[::-1]
        lines.append(
            {
                "label": curve["label"],
                "detail": seeds_and_time(curve),
                "color": color,
                "line": list(zip(across, map(y, measure["mid"]), strict=True)),
                "band": band,
            }
        )
    return {
        "title": _TITLES[name],
        "width": _WIDTH,
        "height": _HEIGHT,
        "left": _LEFT,
        "right": _WIDTH - _RIGHT,
        "bottom": _HEIGHT - _BOTTOM,
        "ticks": [{"y": y(v), "text": f"{v:.3g}"} for v in (low + (high - low) * i / 4 for i in range(5))],
        "steps": [{"x": x(farthest * i / 4), "text": thousands(farthest * i / 4)} for i in range(5)],
        "lines": lines,
        "others": [{**other, "x": x(other["steps"]), "y": y(other["episode_return"])} for other in others],
    }


def _ends(measure: Mapping[str, Any]) -> list[float]:
    return [v for part in ("low", "mid", "high") if measure[part] is not None for v in measure[part]]


def thousands(steps: float) -> str:
    """``2500000`` as ``2.5M``, ``4000`` as ``4k``."""
    for size, letter in ((1e6, "M"), (1e3, "k")):
        if steps >= size:
            return f"{steps / size:.3g}{letter}"
    return f"{steps:.0f}"
