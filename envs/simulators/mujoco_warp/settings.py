"""Settings of this simulator in a scenario: the block ``simulators["mujoco_warp"]``."""

from dataclasses import dataclass, replace
from typing import override

from envs.core.ranges import check_ranges
from envs.scenario import ScenarioCfg
from envs.scenario.simulator_settings import SimulatorSettings

SIMULATOR = "mujoco_warp"

CONTACTS_PER_OBJECT = 32
"""A third more than the most that a task of the benchmark was seen to have: two nuts on their pegs, 73."""

PARTS_OF_A_FILE = 2
"""An object of a file counts as so many: a nut has seven boxes, and two nuts on their pegs that a policy
knocks about needed more than 384 rows, where perturbed experts need 297."""

ROWS_PER_CONTACT = 4
"""Elliptic cones with torsional friction (condim 4)."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WarpSettings(SimulatorSettings):
    """Sizes of buffers that are allocated once, and where.

    Attributes:
        device: ``auto`` (the GPU if there is one), ``cpu``, ``cuda`` or ``cuda:1``.
        nconmax: Contacts per world, on average over the worlds; None is 32 for the robots and for each free
            or jointed object, 64 for one that a file describes.
        njmax: Constraint rows of any one world; None is four, as a contact of our scenes takes, for each of
            ``nconmax``.
        nccdmax: Contacts per world that need the general convex algorithm; None is ``nconmax``.
        deterministic: On a GPU: mujoco_warp's ordered sums, which take some of the speed. They bring runs
            nearer to each other; contacts of mujoco_warp 4.0 are not bit-identical. On a CPU they are.
        render_worlds: Worlds that are rendered at once; bounds the memory of images.
        num_textures: Images of materials that are kept on the device, 256 KiB each.
    """

    simulator = SIMULATOR

    device: str = "auto"
    nconmax: int | None = None
    njmax: int | None = None
    nccdmax: int | None = None
    deterministic: bool = False
    render_worlds: int = 4096
    num_textures: int = 1024

    def __post_init__(self) -> None:
        names = ("nconmax", "njmax", "render_worlds", "num_textures")
        check_ranges(self, f"{SIMULATOR}: ", from_1=names)

    @override
    def sized(self, scenario: ScenarioCfg) -> "WarpSettings":
        moving = [item for item in scenario.objects if item.kind == "free" or item.joint_names]
        parts = sum(1 if item.mjcf is None else PARTS_OF_A_FILE for item in moving)
        nconmax = self.nconmax or CONTACTS_PER_OBJECT * (1 + parts)
        return replace(self, nconmax=nconmax, njmax=self.njmax or ROWS_PER_CONTACT * nconmax)
