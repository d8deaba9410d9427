"""Layouts that divide a surface into pieces: courses of bricks or boards, herringbone, basket weave."""

from dataclasses import dataclass

import numpy as np

from envs.randomization.procedural.noise import Field, Stream, coordinates


@dataclass(frozen=True, slots=True)
class Pieces:
    """A division of the texture into rectangular pieces.

    Attributes:
        piece: Number of each pixel's piece, (size, size) int32.
        count: Number of pieces.
        along: Position along the piece, in [0, 1].
        across: Position across the piece, in [0, 1].
        edge: Distance to the nearest edge of the piece, in widths of a piece.
        turned: True where a piece runs down the texture instead of across, (size, size) bool, or None.
    """

    piece: np.ndarray
    count: int
    along: Field
    across: Field
    edge: Field
    turned: np.ndarray | None = None

    def each(self, values: np.ndarray) -> np.ndarray:
        """Spreads one value (or row of values) for each piece over its pixels."""
        return np.take(values, self.piece, axis=0)


def _edge(along: Field, across: Field, length: float) -> Field:
    """Returns the distance to the nearest edge of a piece ``length`` times longer than wide."""
    return np.minimum(np.minimum(across, 1 - across), np.minimum(along, 1 - along) * length)


def courses(
    size: int,
    rows: int,
    cols: int,
    shifts: np.ndarray | float = 0.5,
    *,
    du: Field | float = 0.0,
    dv: Field | float = 0.0,
) -> Pieces:
    """Divides the texture into ``rows`` courses of ``cols`` pieces.

    Args:
        size: Pixels along a side.
        rows: Courses; where ``shifts`` is a number, ``rows * shifts`` must be an integer.
        cols: Pieces in a course.
        shifts: Every course's shift in widths of a piece, (rows,), or the shift of each against the last.
        du: Displacement across, of the texture's side, which roughens the edges.
        dv: Displacement down.
    """
    u, v = coordinates(size)
    y = (v + dv) * rows
    row = np.floor(y)
    across = y - row
    row = row.astype(np.int32) % rows
    offsets = shifts if isinstance(shifts, np.ndarray) else np.arange(rows, dtype=np.float32) * shifts
    x = (u + du) * cols + np.take(np.asarray(offsets, dtype=np.float32), row)
    col = np.floor(x)
    along = x - col
    piece = row * cols + col.astype(np.int32) % cols
    return Pieces(piece, rows * cols, along, across, _edge(along, across, rows / cols))


def herringbone(size: int, length: int, repeats: int) -> Pieces:
    """Divides the texture into a herringbone of pieces ``length`` times longer than wide.

    Args:
        size: Pixels along a side.
        length: Length of a piece in its widths.
        repeats: Periods of the pattern, each ``2 * length`` widths.
    """
    squares = 2 * length * repeats
    u, v = coordinates(size)
    x, y = u * squares, v * squares
    col, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    fx, fy = x - col, y - row
    step = (col - row) % (2 * length)
    turned = step >= length
    start_row = (row - (2 * length - 1 - step)) % squares
    piece = np.where(turned, start_row * squares + col, row * squares + (col - step) % squares)
    along = np.where(turned, 2 * length - 1 - step + fy, step + fx).astype(np.float32) / length
    across = np.where(turned, fx, fy).astype(np.float32)
    return Pieces(piece, squares * squares, along, across, _edge(along, across, length), turned)


def basket(size: int, strips: int, repeats: int) -> Pieces:
    """Divides the texture into squares of ``strips`` strips that lie crosswise in turn.

    Args:
        size: Pixels along a side.
        strips: Strips in a square.
        repeats: Squares along a side; even.
    """
    u, v = coordinates(size)
    x, y = u * repeats, v * repeats
    col, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
    fx, fy = x - col, y - row
    turned = (col + row) % 2 == 1
    position = np.where(turned, fx, fy).astype(np.float32) * strips
    strip = np.floor(position).astype(np.int32)
    along = np.where(turned, fy, fx).astype(np.float32)
    across = position - strip
    piece = (row * repeats + col) * strips + strip
    return Pieces(piece, repeats * repeats * strips, along, across, _edge(along, across, strips), turned)


def gather(field: np.ndarray, pieces: Pieces, stream: Stream) -> np.ndarray:
    """Cuts every piece out of ``field`` at a random place, along the piece's own direction.

    Args:
        field: What pieces are cut from, (size, size, ...); its rows run along a piece.
        pieces: The pieces.
        stream: Source of the places.
    """
    size = field.shape[0]
    place = np.floor(stream.array(0.0, size, 2, pieces.count)).astype(np.int32)
    row, col = np.indices((size, size), dtype=np.int32)
    if pieces.turned is not None:
        row, col = np.where(pieces.turned, col, row), np.where(pieces.turned, row, col)
    row = (row + pieces.each(place[0])) % size
    col = (col + pieces.each(place[1])) % size
    return np.take(field.reshape(size * size, *field.shape[2:]), row * size + col, axis=0)
