"""The table of checked conversions: a file of rows, and the page that shows it, a line per robot."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

MAX_POSITION_ERROR_M = 1e-5
MAX_INERTIAL_ERROR = 1e-6


@dataclass(frozen=True, slots=True)
class Errors:
    """Largest differences between a source and what a program read of its conversion.

    Attributes:
        position_m: Of a link's position, over all postures.
        rotation_rad: Of a link's orientation, likewise.
        mass: Of a link's mass, relative to the robot's.
        inertia: Of a link's inertia matrix, relative to its largest entry, or of its centre of mass, m.
    """

    position_m: float
    rotation_rad: float
    mass: float
    inertia: float

    @property
    def passed(self) -> bool:
        """Whether they are within :data:`MAX_POSITION_ERROR_M` and :data:`MAX_INERTIAL_ERROR`."""
        small = max(self.mass, self.inertia) <= MAX_INERTIAL_ERROR
        return small and self.position_m <= MAX_POSITION_ERROR_M


@dataclass(frozen=True, slots=True)
class Row:
    """One robot read by one program.

    Attributes:
        robot: Its name.
        program: What read it.
        errors: The differences, or None where it could not be converted or read.
        note: Why not, or what differs.
        losses: What the format leaves out.
        links: Number of links compared.
        joints: Number of joints that move.
        postures: Number of postures.
        version: Of the program.
    """

    robot: str
    program: str
    errors: Errors | None
    note: str = ""
    losses: tuple[str, ...] = ()
    links: int = 0
    joints: int = 0
    postures: int = 0
    version: str = ""

    @property
    def verdict(self) -> str:
        """``pass`` or ``fail``."""
        return "pass" if self.errors is not None and self.errors.passed else "fail"

    def to_dict(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        return {**asdict(self), "losses": list(self.losses)}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Row":
        """Reads what :meth:`to_dict` wrote."""
        errors = values["errors"]
        found = None if errors is None else Errors(**errors)
        return cls(**{**values, "losses": tuple(values["losses"]), "errors": found})


def merged(kept: Iterable[Row], new: Iterable[Row]) -> list[Row]:
    """Returns all rows; a new one takes the place of an old one of the same robot and program."""
    found = {(row.robot, row.program): row for row in kept}
    found.update({(row.robot, row.program): row for row in new})
    return list(found.values())


def read_rows(path: Path) -> list[Row]:
    """Reads rows; none where there is no file."""
    if not path.is_file():
        return []
    return [Row.from_dict(values) for values in json.loads(path.read_text(encoding="utf-8"))]


def write_rows(path: Path, rows: Iterable[Row]) -> None:
    """Writes rows, one a line."""
    lines = ",\n".join(json.dumps(row.to_dict()) for row in rows)
    path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def table(rows: Sequence[Row]) -> str:
    """Returns the rows as a Markdown table: a line per robot, a column per program."""
    programs = list(dict.fromkeys(row.program for row in rows))
    lines = [f"| robot | links, joints | {' | '.join(programs)} | note |", "|---" * (len(programs) + 3) + "|"]
    for robot in dict.fromkeys(row.robot for row in rows):
        own = {row.program: row for row in rows if row.robot == robot}
        size = next((f"{row.links}, {row.joints}" for row in own.values() if row.links), "")
        cells = [_cell(own.get(program)) for program in programs]
        lines.append(f"| {' | '.join([robot, size, *cells, _note(own)])} |")
    return "\n".join(lines)


def _cell(row: Row | None) -> str:
    if row is None:
        return "not run"
    if row.errors is None:
        return "**fail**"
    errors = row.errors
    figures = f"{_short(errors.position_m)} m, {_short(max(errors.mass, errors.inertia))}"
    return figures if errors.passed else f"**fail**: {figures}"


def _short(value: float) -> str:
    return f"{value:.0e}" if value else "0"


def _note(rows: dict[str, Row]) -> str:
    """Why a program fails, once where all fail alike, and what a format leaves out."""
    reasons: dict[str, list[str]] = {}
    for row in rows.values():
        if row.note:
            reasons.setdefault(row.note, []).append(row.program)
    parts = [
        reason if len(programs) == len(rows) else f"{', '.join(programs)}: {reason}"
        for reason, programs in reasons.items()
    ]
    parts += dict.fromkeys(loss for row in rows.values() for loss in row.losses)
    return " ".join(parts).replace("|", "/")


_PAGE = """# Conversion of robots

`roboverse convert robot=<robot> to=urdf` (or `to=usd`) writes a robot of a scenario, or any MJCF file, as
URDF or USD; handlers make the same call, and its result is cached by the content of the source.
`roboverse convert robot=<file>.urdf to=mjcf` converts back, through MuJoCo's own loader, with what
`<file>.mujoco.json` beside it holds and URDF cannot: actuators of joints, armature, a free base.
`losses.json` lists what neither holds. Meshes of `package://` paths are looked for in the folders above the
file, or in `packages=<folder>`. USD is written and not read.

This page is written by `{command}`, which runs every program of the table that
is installed and keeps the rows of the others from `{rows}`. Each robot, gripper and base that
robosuite and robosuite_models ship, and our Franka, was converted and read back. A cell says how far a link
lay from where MuJoCo has it, at most, in {postures} random postures, and how far masses (relative to the
robot's), inertia matrices (relative to their largest entry) and centres of mass (in metres) are off. It
passes within 1e-5 m and 1e-6. UsdPhysics is read back by the frames of its joints, through usd-core.
MuJoCo itself refuses three of robosuite's files, for the reasons in the note.

PhysX has no massless links: SAPIEN gives them 1 mg or, where it has collision shapes, what these weigh at
1,000 kg/m³; and its loader takes a mass without inertia for none. Its other failures are these, so such links
need a mass in the source. Genesis and SAPIEN are compared without the visual shapes, which need a renderer.
Genesis reads a URDF that has MuJoCo's `<mujoco>` element by an older parser of its own, with a warning; leave
the element out for it, as this check does.

{counts}

{table}
"""


def page(rows: Sequence[Row], command: str, rows_file: str) -> str:
    """Returns the page that shows the rows."""
    counts = ["| read by | pass | fail |", "|---|---|---|"]
    for program in dict.fromkeys(row.program for row in rows):
        own = [row for row in rows if row.program == program]
        passed = sum(row.verdict == "pass" for row in own)
        version = next((f" {row.version}" for row in own if row.version), "")
        counts.append(f"| {program}{version} | {passed} | {len(own) - passed} |")
    postures = " or ".join(f"{count:,}" for count in sorted({row.postures for row in rows if row.postures}))
    return _PAGE.format(
        command=command, rows=rows_file, postures=postures, counts="\n".join(counts), table=table(rows)
    )
