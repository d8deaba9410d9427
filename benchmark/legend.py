"""A legend below a picture's axes that lies wholly within it, however long and many its names are."""

from collections.abc import Sequence
from textwrap import fill
from typing import Any

_SHORTEST_LINE = 10
"""Characters: below this, lines of a name are broken no further."""


def legend_below(figure: Any, handles: Sequence[Any], labels: Sequence[str], columns: int = 2) -> None:
    """Adds a legend below the axes, in as many columns as fit, and lets the figure grow by its height.

    Names that are wider than the picture are broken into lines.

    Args:
        figure: The figure, of the resolution that it is saved with: text is as wide as its pixels allow.
        handles: What is drawn, in order.
        labels: Their names.
        columns: The most columns.
    """
    if not labels:
        return
    for number in range(columns, 0, -1):
        legend = _legend(figure, handles, labels, number)
        if _fits(legend, figure):
            break
        legend.remove()
    else:
        legend = _broken(figure, handles, labels)
    height = legend.get_window_extent().height / figure.dpi
    figure.set_figheight(figure.get_figheight() + height)


def _broken(figure: Any, handles: Sequence[Any], labels: Sequence[str]) -> Any:
    """Returns a legend of one column whose names are broken at the longest line that fits."""
    length = max(map(len, labels))
    while True:
        length -= 1
        legend = _legend(figure, handles, [fill(label, length) for label in labels], 1)
        if length <= _SHORTEST_LINE or _fits(legend, figure):
            return legend
        legend.remove()


def _legend(figure: Any, handles: Sequence[Any], labels: Sequence[str], columns: int) -> Any:
    return figure.legend(handles, labels, frameon=False, fontsize=8, loc="outside lower left", ncols=columns)


def _fits(legend: Any, figure: Any) -> bool:
    margins = 2 * figure.get_layout_engine().get()["w_pad"] * figure.dpi
    return legend.get_window_extent().width <= figure.bbox.width - margins
