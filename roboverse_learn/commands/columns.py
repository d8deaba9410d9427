"""Rows of text in columns, as commands print them where no table with borders is wanted."""

from collections.abc import Container, Sequence


def columns(rows: Sequence[Sequence[str]], right: Container[int] = ()) -> list[str]:
    """Returns a line for each row, whose cells stand below one another.

    Args:
        rows: Rows of as many cells; the last cell of a row is as long as it likes.
        right: Columns that end, not begin, at one place, as numbers do.
    """
    widths = [max(map(len, column)) for column in list(zip(*rows, strict=True))[:-1]]
    return [
        "  "
        + "  ".join(
            text.rjust(width) if index in right else text.ljust(width)
            for index, (text, width) in enumerate(zip(row, [*widths, 0], strict=True))
        ).rstrip()
        for row in rows
    ]
