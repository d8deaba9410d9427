"""A legend below an image's axes that fits into the image, however long and many its names are."""

from bisect import bisect_left
from collections.abc import Sequence
from textwrap import fill
from typing import Any

_SHORTEST_LINE = 10
"""Characters: below this, lines of a name are broken no further."""


def legend_below(figure: Any, handles: Sequence[Any], labels: Sequence[str], columns: int = 2) -> None:
    """Adds a legend below the axes, in as many columns as fit, and lets the figure grow by its height.

    Names that are wider than the image are broken into lines.

    Args:
        figure: The figure, of the resolution that it is saved with: text is as wide as its pixels allow.
        handles: The plotted artists, in order.
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
    legend = _legend(figure, handles, labels, 1)

    def broken_is_too_wide(length: int) -> bool:
        for text, label in zip(legend.get_texts(), labels, strict=True):
            text.set_text(fill(label, length))
        return not _fits(legend, figure)

    longer = range(_SHORTEST_LINE + 1, max(map(len, labels)))
    broken_is_too_wide(_SHORTEST_LINE + bisect_left(longer, True, key=broken_is_too_wide))
    return legend


def _legend(figure: Any, handles: Sequence[Any], labels: Sequence[str], columns: int) -> Any:
    return figure.legend(handles, labels, frameon=False, fontsize=8, loc="outside lower left", ncols=columns)


def _fits(legend: Any, figure: Any) -> bool:
    margins = 2 * figure.get_layout_engine().get()["w_pad"] * figure.dpi
    return legend.get_window_extent().width <= figure.bbox.width - margins
