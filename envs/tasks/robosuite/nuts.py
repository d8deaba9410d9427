"""Nuts and pegs of robosuite's NutAssembly (``models/assets/arenas/pegs_arena.xml``, MIT)."""

from dataclasses import dataclass

from envs.scenario import GeomCfg

TABLE_HEIGHT_M = 0.82
NUT_HALF_HEIGHT_M = 0.01
PEG_HALF_HEIGHT_M = 0.1
PEG_Z_M = 0.85 - TABLE_HEIGHT_M
PEG_TOP_M = PEG_Z_M + PEG_HALF_HEIGHT_M
"""The lower part of each peg is inside the table."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Nut:
    """A kind of nut and its peg.

    Attributes:
        name: Name of the nut.
        peg: Name of its peg.
        peg_geom: The peg.
        peg_pos: The peg's middle, m.
        side: 1 if the nut starts at positive y, -1 if at negative.
        handle_m: Distance of the handle's middle from the nut's centre, along the nut's x axis: where
            robosuite's reward reaches for.
        grip_m: Where the expert takes the handle: clear of the ring.
    """

    name: str
    peg: str
    peg_geom: GeomCfg
    peg_pos: tuple[float, float, float]
    side: int
    handle_m: float
    grip_m: float

    @property
    def mjcf(self) -> str:
        """The nut's file."""
        return f"robosuite:models/assets/objects/{self.name.replace('_', '-')}.xml"


SQUARE_NUT = Nut(
    name="square_nut",
    peg="square_peg",
    peg_geom=GeomCfg(shape="box", size=(0.016, 0.016, PEG_HALF_HEIGHT_M), rgba=(0.62, 0.45, 0.12, 1.0)),
    peg_pos=(0.23, 0.1, PEG_Z_M),
    side=1,
    handle_m=0.054,
    grip_m=0.062,
)
ROUND_NUT = Nut(
    name="round_nut",
    peg="round_peg",
    peg_geom=GeomCfg(shape="cylinder", size=(0.02, PEG_HALF_HEIGHT_M), rgba=(0.45, 0.46, 0.48, 1.0)),
    peg_pos=(0.23, -0.1, PEG_Z_M),
    side=-1,
    handle_m=0.06,
    grip_m=0.068,
)
