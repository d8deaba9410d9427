"""Whether converted robots are the robots that they were: where their links are, and what they weigh.

``python -m envs.convert.check`` converts every robot, gripper and base that robosuite ships, and our own,
reads each file back by every program that is installed, and prints a table; ``--write docs/conversion.md``
keeps it.
"""

import argparse
import importlib.util
import logging
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from envs.convert.conversion import convert, describe_loaded
from envs.convert.description import Description, Inertial, Link
from envs.convert.readers import MujocoReader, PybulletReader, Reader, UsdReader
from envs.convert.source import Loaded, load
from envs.errors import RoboVerseError
from envs.robots import ROBOTS
from envs.rotations import conjugate, multiply, rotate, to_matrix

logger = logging.getLogger(__name__)

MAX_POSITION_ERROR_M = 1e-5
MAX_INERTIAL_ERROR = 1e-6
POSTURES = 1000
_UNLIMITED_RANGE = (-3.0, 3.0)

READERS: dict[str, tuple[str, str, Callable[[Path], Reader]]] = {
    "MuJoCo": ("urdf", "mujoco", MujocoReader),
    "PyBullet": ("urdf", "pybullet", PybulletReader),
    "UsdPhysics": ("usd", "pxr", UsdReader),
}
"""Program to the format that it reads, the module that it needs, and its reader."""


@dataclass(frozen=True, slots=True)
class Errors:
    """Largest differences between a source and what a program read of its conversion.

    Attributes:
        position_m: Of a link's position, over all postures.
        rotation_rad: Of a link's orientation, likewise.
        mass: Of a link's mass, relative to the robot's.
        inertia: Of a link's inertia matrix, relative to its largest entry.
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
        note: Why not, or what the format leaves out.
        links: Number of links compared.
        joints: Number of joints that move.
    """

    robot: str
    program: str
    errors: Errors | None
    note: str = ""
    links: int = 0
    joints: int = 0

    @property
    def verdict(self) -> str:
        """``pass`` or ``fail``."""
        return "pass" if self.errors is not None and self.errors.passed else "fail"


def installed() -> tuple[str, ...]:
    """Returns the programs of :data:`READERS` that are installed."""
    return tuple(name for name, (_, module, _) in READERS.items() if importlib.util.find_spec(module))


def robosuite_files() -> tuple[Path, ...]:
    """Returns the MJCF files of robosuite's robots, grippers and bases."""
    spec = importlib.util.find_spec("robosuite")
    assert spec is not None and spec.submodule_search_locations, "robosuite is a dependency"
    assets = Path(spec.submodule_search_locations[0]) / "models" / "assets"
    found = [*assets.glob("robots/*/robot.xml"), *assets.glob("grippers/*.xml"), *assets.glob("bases/*.xml")]
    kinds = ("robots", "grippers", "bases")
    return tuple(sorted(found, key=lambda path: (kinds.index(path.relative_to(assets).parts[0]), str(path))))


def check(source: str | Path, *, programs: Sequence[str] = (), postures: int = POSTURES) -> list[Row]:
    """Converts one robot, and compares what each program reads with MuJoCo's reading of the source.

    Args:
        source: See :func:`envs.convert.convert`.
        programs: Names in :data:`READERS`; those that are installed by default.
        postures: Random postures, within the joints' ranges, at which links are compared.
    """
    programs = programs or installed()
    name = Path(source).parent.name if Path(source).stem == "robot" else Path(source).stem
    try:
        loaded = load(source)
        description = describe_loaded(loaded)
    except RoboVerseError as error:
        return [Row(name, program, None, str(error)) for program in programs]
    rows = []
    for program in programs:
        to, _, read = READERS[program]
        try:
            reader = read(convert(source, to))
        except (RoboVerseError, ValueError) as error:
            rows.append(Row(name, program, None, " ".join(str(error).split())))
            continue
        errors = compare(loaded, description, reader, postures)
        reader.close()
        count = len([link for link in description.links if link.body])
        note = " ".join(description.losses)
        rows.append(Row(name, program, errors, note, count, len(description.joints)))
    return rows


def compare(loaded: Loaded, description: Description, reader: Reader, postures: int) -> Errors:
    """Compares the links of one robot over random postures, and their masses and inertias."""
    model, rng = loaded.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    links = [link for link in description.links if link.body]
    joints = [
        (joint, model.joint(_source_name(loaded, joint.name)).qposadr[0]) for joint in description.joints
    ]
    position = rotation = 0.0
    for _ in range(postures):
        data.qpos[:] = model.qpos0
        if description.floating:
            data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        values = {joint.name: rng.uniform(*(joint.range or _UNLIMITED_RANGE)) for joint, _ in joints}
        for joint, address in joints:
            data.qpos[address] = values[joint.name]
        mujoco.mj_kinematics(model, data)
        read = reader.poses(values)
        for link in links:
            pos, rot = data.xpos[link.body], data.xquat[link.body]
            away = pos + rotate(rot, link.body_offset) - read[link.name][0]
            position = max(position, float(np.linalg.norm(away)))
            half = np.linalg.norm(multiply(conjugate(rot), read[link.name][1])[1:])
            rotation = max(rotation, 2.0 * float(np.arcsin(min(1.0, half))))
    found, total = reader.inertials(), float(model.body_mass.sum())
    ours = {link.name: _source_inertial(model, link) for link in links}
    mass = max(abs(ours[name].mass - found[name].mass) for name in ours) / max(total, 1e-12)
    inertia = max(_inertia_error(ours[name], found[name]) for name in ours)
    return Errors(position, rotation, mass, inertia)


def _source_inertial(model: mujoco.MjModel, link: Link) -> Inertial:
    body = link.body
    com = model.body_ipos[body] - link.body_offset
    return Inertial(float(model.body_mass[body]), com, model.body_iquat[body], model.body_inertia[body])


def _inertia_error(ours: Inertial, theirs: Inertial) -> float:
    """Difference of the inertia matrices, or of the centres of mass (m), whichever is larger."""
    away = float(np.abs(ours.com - theirs.com).max()) if ours.mass > 0 else 0.0
    size = float(np.abs(ours.moments).max())
    return max(away, float(np.abs(_matrix(ours) - _matrix(theirs)).max()) / size if size > 0 else 0.0)


def _matrix(inertial: Inertial) -> np.ndarray:
    turn = to_matrix(inertial.rot / np.linalg.norm(inertial.rot))
    return turn @ np.diag(inertial.moments) @ turn.T


def _source_name(loaded: Loaded, joint: str) -> str | int:
    """A joint's name in the source; one without a name is found by its number."""
    names = [loaded.model.joint(index).name for index in range(loaded.model.njnt)]
    full = f"{loaded.prefix}{joint}"
    return full if full in names else int(joint.removeprefix("joint"))


def table(rows: Iterable[Row]) -> str:
    """Returns the rows as a Markdown table."""
    lines = [
        "| robot | links, joints | read by | position, m | rotation, rad | mass | inertia | verdict | note |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        errors = row.errors
        figures = ["", "", "", ""]
        if errors is not None:
            values = (errors.position_m, errors.rotation_rad, errors.mass, errors.inertia)
            figures = [f"{value:.0e}" if value else "0" for value in values]
        size = f"{row.links}, {row.joints}" if errors is not None else ""
        note = row.note.replace("|", "/")
        lines.append(f"| {' | '.join([row.robot, size, row.program, *figures, row.verdict, note])} |")
    return "\n".join(lines)


_PAGE = """# Conversion of robots

`roboverse convert robot=<robot> to=urdf` (or `to=usd`) writes a robot of a scenario, or any MJCF file, as
URDF or USD; handlers make the same call, and its result is cached by the content of the source.
`to=mjcf` takes a URDF file the other way, through MuJoCo's own loader.

This page is written by `{command}`. Each robot, gripper and base that
robosuite ships, and our own, was converted and read back; links were compared with MuJoCo's in {postures}
random postures (largest distance and turn of a link), masses relative to the whole robot's, inertia matrices
relative to their largest entry, and centres of mass in metres with them. It passes within 1e-5 m and 1e-6.
UsdPhysics is read back by the frames of its joints, through usd-core.

**{passed} of {total} pass.** Programs: {programs}.

{table}
"""


def page(rows: Sequence[Row], postures: int, command: str) -> str:
    """Returns the page that keeps the table."""
    passed = sum(row.verdict == "pass" for row in rows)
    programs = ", ".join(dict.fromkeys(row.program for row in rows))
    return _PAGE.format(
        command=command,
        postures=f"{postures:,}",
        passed=passed,
        total=len(rows),
        programs=programs,
        table=table(rows),
    )


def main(argv: Sequence[str] | None = None) -> int:
    """Checks robots; the exit code is 1 where a robot that MuJoCo can read fails."""
    parser = argparse.ArgumentParser(prog="python -m envs.convert.check", description=main.__doc__)
    parser.add_argument("sources", nargs="*", help="robots or files; all of robosuite's and ours by default")
    parser.add_argument("--programs", nargs="+", choices=tuple(READERS), help="those installed by default")
    parser.add_argument("--postures", type=int, default=POSTURES)
    parser.add_argument("--write", type=Path, help="Markdown file to write")
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
    rows: list[Row] = []
    for source in args.sources or (*ROBOTS.names(), *robosuite_files()):
        new = check(source, programs=args.programs or (), postures=args.postures)
        rows += new
        for row in new:
            logger.info("%s %s by %s: %s", row.verdict, row.robot, row.program, row.errors or row.note)
    if args.write is not None:
        words = "python -m envs.convert.check --write docs/conversion.md"
        args.write.write_text(page(rows, args.postures, words), encoding="utf-8")
    return int(any(row.errors is not None and not row.errors.passed for row in rows))


if __name__ == "__main__":
    logging.getLogger("envs.convert.conversion").setLevel(logging.ERROR)  # the rows say it
    sys.exit(main())
