"""Colour of each row on the leaderboard page; where colours repeat, line styles differ."""

from typing import NamedTuple

from benchmark.leaderboard.plots import COLORS

_DASHES = ("", "9 3", "2 3", "9 3 2 3")


class RowStyle(NamedTuple):
    """Style of a row.

    Attributes:
        color: Its colour.
        round: How many rows before it have that colour; its marker and its square are hollow after the first.
        dash: The ``stroke-dasharray`` of its lines; empty for a line without gaps.
    """

    color: str
    round: int
    dash: str


def row_style(index: int) -> RowStyle:
    """Returns the style of the row at an index of its section."""
    again = index // len(COLORS) % len(_DASHES)
    return RowStyle(COLORS[index % len(COLORS)], again, _DASHES[again])
