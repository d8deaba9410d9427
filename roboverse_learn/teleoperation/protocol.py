"""Messages of a browser: JSON texts of bounded size, checked before anything acts on them.

======== ==================================================================================================
message  fields
======== ==================================================================================================
join     ``client``: a name that the browser keeps, so that it gets its environment back; ``operator``
move     ``seq``: rising number; ``rate``: 6 entries of the hand's action in [-1, 1], applied at every control
         step until the next message; ``shift``: 6 entries, m and rad, applied once; ``gripper``: in [-1, 1];
         ``device``; ``seen``: the number of the newest frame that arrived
press    ``button``: one of :class:`Button`
view     ``cameras``: names of those whose images are wanted, the first of which is steered by
======== ==================================================================================================
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from envs.core.errors import RoboVerseError

MAX_MESSAGE_BYTES = 2048
"""Size of a browser's largest message; a move takes about 200 bytes."""

MAX_SHIFT_M, MAX_SHIFT_RAD = 0.1, 0.5
"""Largest entries of a shift: two control steps at full speed."""

MAX_NAME = 40
"""Characters of a name."""

MAX_CAMERAS = 4
"""Cameras that a page shows at once."""

DEVICES = ("keyboard", "mouse", "touch", "gamepad", "phone", "webxr", "script", "expert")

STILL = (0.0,) * 6


class ProtocolError(RoboVerseError, ValueError):
    """A message that no page of ours sends."""


class Button(StrEnum):
    """What a person can press."""

    START = "start"
    PAUSE = "pause"
    FINISH = "finish"
    DISCARD = "discard"
    RESET = "reset"
    UNDO = "undo"
    TAKEOVER = "takeover"


@dataclass(frozen=True, kw_only=True, slots=True)
class Join:
    """A browser asks for an environment."""

    client: str
    operator: str = ""


@dataclass(frozen=True, kw_only=True, slots=True)
class Move:
    """A motion of the hand; see the module."""

    seq: int = 0
    rate: tuple[float, ...] = STILL
    shift: tuple[float, ...] = STILL
    gripper: float | None = None
    device: str = "keyboard"
    seen: int = 0

    @property
    def moves(self) -> bool:
        """Whether the hand is to move."""
        return any(self.rate) or any(self.shift)


@dataclass(frozen=True, kw_only=True, slots=True)
class Press:
    """A button was pressed."""

    button: Button


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """Other cameras are wanted."""

    cameras: tuple[str, ...]


Message = Join | Move | Press | View


def parse(text: str) -> Message:
    """Returns the message of a text.

    Raises:
        ProtocolError: It is no message, or a value is out of range.
    """
    try:
        given = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise ProtocolError("A message must be a JSON object.") from error
    if not isinstance(given, dict):
        raise ProtocolError("A message must be a JSON object.")
    kinds = {"join": _join, "move": _move, "press": _press, "view": _view}
    kind = given.pop("type", None)
    if not isinstance(kind, str) or kind not in kinds:
        raise ProtocolError(f"Unknown type of message. Valid: {', '.join(kinds)}.")
    return kinds[kind](given)


def _join(given: dict[str, Any]) -> Join:
    _only(given, "client", "operator")
    client = _name(given, "client")
    if not client:
        raise ProtocolError("join needs a client.")
    return Join(client=client, operator=_name(given, "operator"))


def _move(given: dict[str, Any]) -> Move:
    _only(given, "seq", "rate", "shift", "gripper", "device", "seen")
    device = given.get("device", "keyboard")
    if device not in DEVICES:
        raise ProtocolError(f"Unknown device. Valid: {', '.join(DEVICES)}.")
    limits = (MAX_SHIFT_M,) * 3 + (MAX_SHIFT_RAD,) * 3
    gripper = given.get("gripper")
    return Move(
        seq=_count(given, "seq"),
        rate=_six(given, "rate", (1.0,) * 6),
        shift=_six(given, "shift", limits),
        gripper=None if gripper is None else _clipped("gripper", gripper, 1.0),
        device=device,
        seen=_count(given, "seen"),
    )


def _press(given: dict[str, Any]) -> Press:
    _only(given, "button")
    try:
        return Press(button=Button(given.get("button")))
    except ValueError as error:
        raise ProtocolError(f"Unknown button. Valid: {', '.join(Button)}.") from error


def _view(given: dict[str, Any]) -> View:
    _only(given, "cameras")
    names = given.get("cameras")
    if not isinstance(names, list) or not 1 <= len(names) <= MAX_CAMERAS:
        raise ProtocolError(f"cameras must be a list of 1 to {MAX_CAMERAS} names.")
    return View(cameras=tuple(dict.fromkeys(_name({"camera": name}, "camera") for name in names)))


def _only(given: Mapping[str, Any], *fields: str) -> None:
    if unknown := sorted(set(given) - set(fields)):
        raise ProtocolError(f"Unknown field '{unknown[0][:MAX_NAME]}'. Valid: {', '.join(fields)}.")


def _name(given: Mapping[str, Any], key: str) -> str:
    value = given.get(key, "")
    if not isinstance(value, str) or len(value) > MAX_NAME or not value.isprintable():
        raise ProtocolError(f"{key} must be a text of at most {MAX_NAME} printable characters.")
    return value.strip()


def _count(given: Mapping[str, Any], key: str) -> int:
    value = given.get(key, 0)
    if type(value) is not int or not 0 <= value < 2**53:
        raise ProtocolError(f"{key} must be a whole number from 0 on.")
    return value


def _six(given: Mapping[str, Any], key: str, limits: tuple[float, ...]) -> tuple[float, ...]:
    values = given.get(key, STILL)
    if not isinstance(values, list | tuple) or len(values) != 6:
        raise ProtocolError(f"{key} must be a list of 6 numbers.")
    return tuple(_clipped(key, value, limit) for value, limit in zip(values, limits, strict=True))


def _clipped(key: str, value: Any, limit: float) -> float:
    """Returns a number within ± ``limit``: a browser's rounding is no reason to refuse it."""
    if type(value) not in (int, float) or abs(value) > 1e6 or not math.isfinite(value):
        raise ProtocolError(f"{key} must hold finite numbers.")
    return min(max(float(value), -limit), limit)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON.")
