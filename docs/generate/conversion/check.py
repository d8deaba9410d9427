"""Checks that converted robots have the kinematics, masses and inertias of their sources.

``python -m docs.generate.conversion.check`` converts every robot, gripper and base that robosuite and
robosuite_models ship, and our own, loads each file in every installed program, and prints a table.
``write=docs/conversion.md`` writes the page, and its rows in a JSON file beside it, to which another run may
add.
"""

import importlib.metadata
import importlib.util
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from docs.generate.conversion.readers import MujocoReader, PybulletReader, Reader, UsdReader
from docs.generate.conversion.simulator_readers import GenesisReader, SapienReader
from docs.generate.conversion.table import (
    MAX_INERTIAL_ERROR,
    MAX_POSITION_ERROR_M,
    Errors,
    Row,
    merged,
    page,
    read_rows,
    table,
    write_rows,
)
from envs.convert.conversion import convert, describe_loaded
from envs.convert.description import Description, Link
from envs.convert.source import Loaded, load
from envs.core.arguments import run_program
from envs.core.errors import RoboVerseError, unknown_name
from envs.mjcf.link_tree import Inertia
from envs.rotations import conjugate, multiply, rotate, to_matrix

logger = logging.getLogger(__name__)

_COMMAND = "python -m docs.generate.conversion.check"
POSTURES = 1000
_OWN = "franka"
"""Our own robot in the table; robosuite's files have the names of others."""

_UNLIMITED_RANGE = (-3.0, 3.0)

READERS: dict[str, tuple[str, str, str, Callable[[Path], Reader]]] = {
    "MuJoCo": ("urdf", "mujoco", "mujoco", MujocoReader),
    "PyBullet": ("urdf", "pybullet", "pybullet", PybulletReader),
    "SAPIEN": ("urdf", "sapien", "sapien", SapienReader),
    "Genesis": ("urdf", "genesis", "genesis-world", GenesisReader),
    "UsdPhysics": ("usd", "pxr", "usd-core", UsdReader),
}
"""Program to the format that it reads, the module that it needs, its distribution, and its reader."""

PACKAGES = ("robosuite", "robosuite_models")


def installed() -> tuple[str, ...]:
    """Returns the programs of :data:`READERS` that are installed."""
    return tuple(name for name, (_, module, _, _) in READERS.items() if importlib.util.find_spec(module))


def robosuite_files() -> tuple[Path, ...]:
    """Returns the MJCF files of the robots, grippers and bases of :data:`PACKAGES`, as far as installed."""
    files: list[Path] = []
    for package in PACKAGES:
        spec = importlib.util.find_spec(package)
        if spec is None or not spec.submodule_search_locations:
            continue
        root = Path(spec.submodule_search_locations[0])
        for folder in (root / "models" / "assets", root / "assets"):
            for pattern in ("robots/*/robot.xml", "grippers/*.xml", "bases/*.xml"):
                files += sorted(folder.glob(pattern))
    return tuple(files)


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
    paths: dict[str, Path] = {}
    rows = []
    for program in programs:
        to, _, _, read = READERS[program]
        try:
            if to not in paths:
                paths[to] = convert(source, to)
            reader = read(paths[to])
        except (RoboVerseError, ValueError, RuntimeError) as error:
            rows.append(Row(name, program, None, " ".join(str(error).split())))
            continue
        rows.append(_row(name, program, loaded, description, reader, postures))
        reader.close()
    return rows


def _row(
    name: str, program: str, loaded: Loaded, description: Description, reader: Reader, postures: int
) -> Row:
    errors, note = compare(loaded, description, reader, postures)
    return Row(
        name,
        program,
        errors,
        note,
        description.losses,
        links=len([link for link in description.links if link.body]),
        joints=len(description.joints),
        postures=postures,
        version=importlib.metadata.version(READERS[program][2]),
    )


def compare(loaded: Loaded, description: Description, reader: Reader, postures: int) -> tuple[Errors, str]:
    """Compares the links of one robot over random postures, and their masses and inertias.

    Returns:
        The largest differences, and what exceeds the limits, by name.
    """
    links = [link for link in description.links if link.body]
    away, turned = _distances(loaded, description, reader, postures, links)
    model, found = loaded.model, reader.inertials()
    total = float(model.body_mass.sum()) or 1.0  # in kg where nothing weighs anything
    ours = {link.name: _source_inertial(model, link) for link in links}
    masses = {name: abs(ours[name].mass - found[name].mass) / total for name in ours}
    inertias = {name: _inertia_error(ours[name], found[name]) for name in ours}
    errors = Errors(max(away.values()), max(turned.values()), max(masses.values()), max(inertias.values()))
    notes = []
    if errors.position_m > MAX_POSITION_ERROR_M:
        notes.append(f"{_worst(away, MAX_POSITION_ERROR_M)} off by up to {errors.position_m:.2g} m.")
    heavy = {name: f"{found[name].mass:.3g} instead of {ours[name].mass:.3g} kg" for name in ours}
    if errors.mass > MAX_INERTIAL_ERROR:
        worst = max(masses, key=lambda name: masses[name])
        notes.append(f"{_worst(masses, MAX_INERTIAL_ERROR)} of another mass: {heavy[worst]}.")
    if errors.inertia > MAX_INERTIAL_ERROR:
        notes.append(f"{_worst(inertias, MAX_INERTIAL_ERROR)} of another inertia.")
    return errors, " ".join(notes)


def _worst(values: dict[str, float], limit: float) -> str:
    """Names the link that is worst, and says how many are beyond the limit."""
    beyond = sum(value > limit for value in values.values())
    first = f"'{max(values, key=lambda name: values[name])}'"
    return f"{first} is" if beyond == 1 else f"{first} and {beyond - 1} more are"


def _distances(
    loaded: Loaded, description: Description, reader: Reader, postures: int, links: list[Link]
) -> tuple[dict[str, float], dict[str, float]]:
    """Returns how far each link is off, m, and how far it is turned, rad, at most."""
    model, rng = loaded.model, np.random.default_rng(0)
    data = mujoco.MjData(model)
    joints = [
        (joint, model.joint(_source_name(loaded, joint.name)).qposadr[0]) for joint in description.joints
    ]
    names, bodies = [link.name for link in links], [link.body for link in links]
    pos, rot = np.empty((postures, len(links), 3)), np.empty((postures, len(links), 4))
    read_pos, read_rot = np.empty_like(pos), np.empty_like(rot)
    for index in range(postures):
        data.qpos[:] = model.qpos0
        if description.floating:
            data.qpos[:7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        values = {joint.name: rng.uniform(*(joint.range or _UNLIMITED_RANGE)) for joint, _ in joints}
        for joint, address in joints:
            data.qpos[address] = values[joint.name]
        mujoco.mj_kinematics(model, data)
        pos[index], rot[index] = data.xpos[bodies], data.xquat[bodies]
        read = reader.poses(values)
        for column, name in enumerate(names):
            read_pos[index, column], read_rot[index, column] = read[name]
    offsets = np.broadcast_to(np.array([link.body_offset for link in links]), pos.shape)
    away = np.linalg.norm(pos + rotate(rot, offsets) - read_pos, axis=-1).max(0)
    half = np.linalg.norm(multiply(conjugate(rot), read_rot)[..., 1:], axis=-1).max(0)
    turned = 2.0 * np.arcsin(np.minimum(1.0, half))
    return dict(zip(names, away.tolist(), strict=True)), dict(zip(names, turned.tolist(), strict=True))


def _source_inertial(model: mujoco.MjModel, link: Link) -> Inertia:
    body = link.body
    com = model.body_ipos[body] - link.body_offset
    return Inertia(float(model.body_mass[body]), com, model.body_iquat[body], model.body_inertia[body])


def _inertia_error(ours: Inertia, theirs: Inertia) -> float:
    """Difference of the inertia matrices, or of the centres of mass (m), whichever is larger."""
    away = float(np.abs(ours.com - theirs.com).max()) if ours.mass > 0 else 0.0
    size = float(np.abs(ours.moments).max())
    return max(away, float(np.abs(_matrix(ours) - _matrix(theirs)).max()) / size if size > 0 else 0.0)


def _matrix(inertial: Inertia) -> np.ndarray:
    turn = to_matrix(inertial.rot / np.linalg.norm(inertial.rot))
    return turn @ np.diag(inertial.moments) @ turn.T


def _source_name(loaded: Loaded, joint: str) -> str | int:
    """A joint's name in the source; one without a name is found by its number."""
    names = [loaded.model.joint(index).name for index in range(loaded.model.njnt)]
    full = f"{loaded.prefix}{joint}"
    return full if full in names else int(joint.removeprefix("joint"))


@dataclass(frozen=True, kw_only=True, slots=True)
class CheckSettings:
    """``python -m docs.generate.conversion.check``: converts robots and reads them back.

    Attributes:
        robots: Registered robots or files; empty takes all that are shipped.
        programs: Programs that read them, as in programs=[MuJoCo]; empty takes all that are installed.
        postures: Random postures in which each is compared.
        write: Markdown file to write.
    """

    robots: tuple[str, ...] = ()
    programs: tuple[str, ...] = ()
    postures: int = POSTURES
    write: Path | None = None

    def __post_init__(self) -> None:
        for name in self.programs:
            if name not in READERS:
                raise unknown_name("program that reads robots", name, READERS)


def main(words: Sequence[str] | None = None) -> int:
    """Checks robots; the exit code is 1 where a robot that MuJoCo can read fails."""
    return run_program(_COMMAND, CheckSettings, _check_all, words)


def _check_all(args: CheckSettings) -> int:
    rows: list[Row] = []
    for source in args.robots or (_OWN, *robosuite_files()):
        new = check(source, programs=args.programs, postures=args.postures)
        rows += new
        for row in new:
            logger.info("%s %s by %s: %s %s", row.verdict, row.robot, row.program, row.errors or "", row.note)
    if args.write is not None:
        kept = args.write.with_suffix(".json")
        rows_of_page = merged(read_rows(kept), rows)
        write_rows(kept, rows_of_page)
        words = f"{_COMMAND} write={args.write}"
        args.write.write_text(page(rows_of_page, words, kept.name), encoding="utf-8")
    else:
        logger.info("\n%s", table(rows))
    return int(any(row.errors is not None and not row.errors.passed for row in rows))


if __name__ == "__main__":
    logging.getLogger("envs.convert.conversion").setLevel(logging.ERROR)  # the rows say it
    sys.exit(main())
