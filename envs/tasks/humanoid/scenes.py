"""Objects round the H1 in HumanoidBench's scenes (``assets/tasks`` and ``assets/locomotion``, MIT).

Everything is made from primitives by its published dimensions. Walls that would hide the robot collide
but are invisible; hurdles show their collision shapes.
"""

import dataclasses

from envs.scenario import GROUND, GeomCfg, ObjectCfg, Rgba, Vec3

GREY: Rgba = (0.55, 0.55, 0.58, 1.0)
_ROBOT_NAMES = ("h1",)

WOOD: Rgba = (0.72, 0.55, 0.36, 1.0)


def _box(pos: Vec3, size: Vec3, *, rgba: Rgba = GREY, visible: bool = True) -> GeomCfg:
    return GeomCfg(shape="box", pos=pos, size=size, rgba=rgba, visible=visible, condim=3)


def _fixed(name: str, *geoms: GeomCfg, feels: tuple[str, ...] = ()) -> ObjectCfg:
    return ObjectCfg(name=name, kind="fixed", geoms=geoms, feels=feels)


TUNNEL = dataclasses.replace(
    _fixed(
        "tunnel",
        _box((8.0, -1.35, 0.775), (8.0, 0.2, 0.775)),
        _box((8.0, 1.35, 0.775), (8.0, 0.2, 0.775), visible=False),
        _box((8.0, 0.0, 1.35), (8.0, 1.15, 0.2), visible=False),
    ),
    pos=(2.2, 0.0, 0.0),
)
"""``crawl.xml``: 16 m long, 2.3 m wide, 1.15 m high."""

HURDLES = _fixed(
    "hurdles",
    *(_box((7.0 * row, 0.0, 0.1875), (0.03, 5.0, 0.1875)) for row in range(1, 11)),
)
"""``generated_xml_hurdles.xml``: ten of 37.5 cm, 7 m apart."""

HURDLE_WALLS = _fixed(
    "walls",
    _box((35.0, -4.725, 1.0), (35.5, 0.275, 1.0), visible=False),
    _box((35.0, 4.725, 1.0), (35.5, 0.275, 1.0), visible=False),
    _box((-0.525, 0.0, 1.0), (0.05, 5.0, 1.0), visible=False),
    feels=_ROBOT_NAMES,
)

_STEP_HALF_M = 0.09

STAIRS = dataclasses.replace(
    _fixed(
        "stairs",
        *(
            _box(
                (3.0 + 6.0 * flight, 0.0, _STEP_HALF_M * (2 * step + 1)),
                (2.7 - 0.6 * step, 5.0, _STEP_HALF_M),
                rgba=(0.55 + 0.06 * step, 0.55 + 0.06 * step, 0.58 + 0.06 * step, 1.0),
            )
            for flight in range(4)
            for step in range(5)
        ),
    ),
    pos=(0.2, 0.0, 0.0),
)
"""``generated_xml_stairs.xml``: four flights, each five steps of 18 cm up and down."""

STAIR_WALLS = _fixed(
    "walls",
    _box((13.5, -5.05, 2.0), (15.5, 0.1, 2.0), visible=False),
    _box((13.5, 5.05, 2.0), (15.5, 0.1, 2.0), visible=False),
    _box((-2.1, 0.0, 2.0), (0.1, 7.25, 2.0), visible=False),
)

SLIDES = ObjectCfg(name="slides", kind="fixed", mjcf="envs:tasks/humanoid/slides.xml", mjcf_root="slides")
"""``slide.xml``."""

SLIDE_WALLS = _fixed(
    "walls",
    _box((48.85, -5.15, 4.0), (53.0, 0.15, 4.0), visible=False),
    _box((48.85, 5.15, 4.0), (53.0, 0.15, 4.0), visible=False),
    _box((-4.0, 0.0, 4.0), (0.15, 5.15, 4.0), visible=False),
)

_POLE_ROWS = 41

POLES = _fixed(
    "poles",
    *(
        GeomCfg(shape="cylinder", pos=(float(row), y, 1.0), size=(0.05, 1.0), rgba=GREY, condim=3)
        for row in range(1, _POLE_ROWS + 1)
        for y in ((2.25, 0.75, -0.75, -2.25) if row % 2 else (1.5, 0.0, -1.5))
    ),
    feels=_ROBOT_NAMES,
)
"""``generated_xml_poles.xml``: 41 rows 1 m apart, in turn of four and of three poles."""

POLE_WALLS = _fixed(
    "walls",
    _box((20.0, -3.15, 1.0), (20.75, 0.15, 1.0), visible=False),
    _box((20.0, 3.15, 1.0), (20.75, 0.15, 1.0), visible=False),
    _box((-0.6, 0.0, 1.0), (0.15, 3.0, 1.0), visible=False),
)

_MAZE = (
    "#######",
    "#.....#",
    "###.#.#",
    "#.....#",
    "#.#.###",
    "#.....#",
    "#######",
)
"""Seen from above, x to the right and y up; a block is 1.5 m wide and 1.2 m high."""

MAZE = dataclasses.replace(
    _fixed(
        "maze",
        *(
            _box((0.75 + 1.5 * column, 9.75 - 1.5 * row, 0.6), (0.75, 0.75, 0.6))
            for row, line in enumerate(_MAZE)
            for column, cell in enumerate(line)
            if cell == "#"
        ),
        feels=_ROBOT_NAMES,
    ),
    pos=(-2.25, -2.25, 0.0),
)
"""``generated_xml_maze.xml``."""

CHECKPOINT = ObjectCfg(
    name="checkpoint",
    kind="marker",
    geoms=(GeomCfg(shape="sphere", size=(0.05,), rgba=(0.9, 0.1, 0.1, 1.0)),),
)
"""``maze.xml``: where to go next."""

_DENSITY = 1000.0
"""MuJoCo's, kg/m³, of visual shapes; collision shapes have no mass."""


def _drawn(pos: Vec3, size: Vec3, rgba: Rgba = WOOD) -> GeomCfg:
    mass = 8.0 * size[0] * size[1] * size[2] * _DENSITY
    return GeomCfg(shape="box", pos=pos, size=size, mass_kg=mass, rgba=rgba, collides=False)


CHAIR_PARTS = (
    *(_drawn((x, y, 0.225), (0.02, 0.02, 0.225)) for x in (0.19, -0.19) for y in (0.19, -0.19)),
    _drawn((0.0, 0.0, 0.45), (0.21, 0.21, 0.025)),
    _drawn((-0.23, 0.19, 0.6375), (0.02, 0.02, 0.2125)),
    _drawn((-0.23, -0.19, 0.6375), (0.02, 0.02, 0.2125)),
    _drawn((-0.23, 0.0, 0.77), (0.02, 0.21, 0.08)),
    _box((-0.23, 0.0, 0.65), (0.02, 0.21, 0.2), visible=False),
    _box((0.0, 0.0, 0.2375), (0.21, 0.21, 0.2375), visible=False),
)

FIXED_CHAIR = dataclasses.replace(_fixed("chair", *CHAIR_PARTS), pos=(-0.25, 0.0, 0.0))
"""``sit_simple.xml``."""

CHAIR = dataclasses.replace(FIXED_CHAIR, kind="free")
"""``sit_hard.xml``: 15.7 kg."""

BOARD_SIZE: Vec3 = (0.15, 0.55, 0.03)
BALL_RADIUS_M = 0.17

BOARD = ObjectCfg(
    name="board",
    geoms=(
        _drawn((0.0, 0.0, 0.0), BOARD_SIZE, GREY),
        _box((0.0, 0.0, 0.0), BOARD_SIZE, visible=False),
    ),
    pos=(0.0, 0.0, 0.37),
    feels=(GROUND,),
)
"""``balance_simple.xml``, as it is since its second version: 19.8 kg."""

BALL = ObjectCfg(
    name="ball",
    geoms=(
        GeomCfg(
            shape="sphere",
            size=(BALL_RADIUS_M,),
            mass_kg=4.18879 * BALL_RADIUS_M**3 * _DENSITY,
            rgba=(0.3, 0.3, 0.3, 1.0),
            condim=3,
        ),
    ),
    pos=(0.0, 0.0, BALL_RADIUS_M),
)
"""``balance_hard.xml``: 20.6 kg."""

FIXED_BALL = dataclasses.replace(BALL, kind="fixed")
"""``balance_simple.xml``."""
