"""Pieces and layouts are named, fit their places, and obstruct nothing."""

import itertools
import math

import numpy as np
import pytest

from envs.mjcf.furniture import FURNITURE
from envs.mjcf.model import build_model
from envs.randomization import LEVEL_CHANNELS, Randomizer
from envs.randomization.camera_poses import CAMERA_POSES, place_camera
from envs.randomization.furniture import draw_furniture, furnish, keep_free
from envs.randomization.furniture_catalogue import AT_WALL, LAYOUTS, PIECES, VARIANTS, layout, piece
from envs.scenario import RobotCfg, RoomCfg, ScenarioCfg, TableCfg
from envs.scenario.places import PLACE_SHAPES, places_of
from envs.tasks import TASKS

FAMILIES = [name for name in TASKS.names("benchmark")]


def corners_of(geom):
    """The four corners of a geom's footprint in the world, (4, 2)."""
    half = geom.size[:2] if geom.shape == "box" else (geom.size[0],) * 2
    yaw = 2 * math.atan2(geom.rot[3], geom.rot[0])
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    signs = np.array(list(itertools.product((-1, 1), repeat=2)))
    return (signs * half) @ turn.T + geom.pos[:2]


def looks(scenario, count=40, split="train"):
    randomizer = Randomizer(
        scenario.appearance,
        scenario.cameras,
        channels=("environment",),
        split=split,
        seed=0,
        scenario=scenario,
    )
    return [randomizer.appearance(int(episode)) for episode in randomizer.split.episodes[:count]]


@pytest.mark.parametrize("name", PIECES)
def test_a_piece_is_made_of_what_its_place_has(name):
    kind = "wall" if name.rpartition("-")[0] in AT_WALL else "corner"
    item = piece(name)
    used = [geom.shape for geom in item.geoms]
    assert all(used.count(shape) <= PLACE_SHAPES[kind].get(shape, 0) for shape in set(used))
    assert all(geom.pos[2] + 1e-9 >= geom.size[-1] * (geom.shape != "sphere") for geom in item.geoms)
    assert item.half_width_m <= 0.6 and item.half_depth_m <= 0.45
    assert not any(geom.collides for geom in item.geoms)


def test_variants_of_a_kind_differ():
    for first in range(0, len(PIECES), VARIANTS):
        shapes = {piece(name).geoms for name in PIECES[first : first + VARIANTS]}
        assert len(shapes) == VARIANTS


def test_layouts_differ_and_leave_places_empty():
    assert len({tuple(layout(name).items()) for name in LAYOUTS}) == len(LAYOUTS)
    assert min(len(layout(name)) for name in LAYOUTS) >= 4
    assert any(len(layout(name)) < len(places_of(3.0)) for name in LAYOUTS)


@pytest.mark.slow
@pytest.mark.parametrize("task", FAMILIES)
def test_furniture_is_inside_the_room_and_outside_free_space(task):
    scenario = TASKS.get(task)().scenario
    circles = keep_free(scenario)
    assert scenario.room is not None
    inside = scenario.room.half_size_m - 0.04
    standing = 0
    for look in looks(scenario):
        for geom in itertools.chain.from_iterable(look.furniture.values()):
            corners = corners_of(geom)
            assert np.abs(corners).max() <= inside
            for circle in circles:
                nearest = np.hypot(*(corners - (circle.x, circle.y)).T).min()
                assert nearest > circle.radius - 0.25, "a corner; the footprint is checked exactly below"
            standing += 1
    assert standing > 0


@pytest.mark.parametrize("task", FAMILIES)
def test_no_camera_looks_through_furniture(task):
    """Cameras stand in circles that furniture does not reach into, and so does all that they look at."""
    scenario = TASKS.get(task)().scenario
    circles = keep_free(scenario)
    cameras = [camera for camera in scenario.cameras if camera.mount is None]
    for camera in cameras:
        for seen in (camera, *(place_camera(camera, pose) for pose in CAMERA_POSES)):
            assert any(
                math.hypot(seen.pos[0] - c.x, seen.pos[1] - c.y) < c.radius
                and math.hypot(seen.look_at[0] - c.x, seen.look_at[1] - c.y) < c.radius
                for c in circles
            )


def test_pieces_of_one_room_do_not_reach_into_each_other():
    for look in looks(TASKS.get("PickCube")().scenario, 60):
        boxes = {}
        for place, geoms in look.furniture.items():
            corners = np.concatenate([corners_of(geom) for geom in geoms])
            boxes[place] = (corners.min(0), corners.max(0))
        for (_, a), (_, b) in itertools.combinations(boxes.items(), 2):
            overlap = np.minimum(a[1], b[1]) - np.maximum(a[0], b[0])
            assert overlap.min() < 0.03


def test_a_room_that_is_too_small_has_less_furniture_and_none_without_a_room():
    large = ScenarioCfg(table=TableCfg(half_size=(0.5, 0.5)), room=RoomCfg(half_size_m=3.0))
    small = ScenarioCfg(table=TableCfg(half_size=(0.5, 0.5)), room=RoomCfg(half_size_m=0.9))
    _, placements = draw_furniture(np.random.default_rng(0), LAYOUTS, PIECES)
    assert len(furnish(large, placements)) == len(placements)
    assert len(furnish(small, placements)) < len(placements)
    assert furnish(ScenarioCfg(room=None), placements) == {}


def test_the_draw_depends_on_its_own_stream_and_not_on_the_cameras_that_are_read():
    scenario = TASKS.get("PickCube")().scenario
    whole, bare = (
        Randomizer(
            scenario.appearance,
            scenario.cameras,
            channels=LEVEL_CHANNELS,
            split="test",
            seed=0,
            scenario=item,
        )
        for item in (scenario, None)
    )
    episode = int(whole.split.episodes[3])
    with_it, without = whole.draws(episode), bare.draws(episode)
    assert with_it["environment"]["textures"] == without["environment"]["textures"]
    assert with_it["environment"]["table_yaw_rad"] == without["environment"]["table_yaw_rad"]
    assert without["environment"]["layout"] is None and without["environment"]["furniture"] == []
    assert {item["piece"] for item in with_it["environment"]["furniture"]} <= set(whole.split.furniture)
    assert with_it["environment"]["layout"] in whole.split.layouts


@pytest.mark.slow
def test_no_furnished_room_of_the_test_split_is_one_of_the_other():
    scenario = TASKS.get("PickCube")().scenario
    train, test = (
        {tuple(sorted(look.furniture.items())) for look in looks(scenario, 300, split)}
        for split in ("train", "test")
    )
    assert not train & test
    pieces = [{geom.size for room in rooms for _, geoms in room for geom in geoms} for rooms in (train, test)]
    assert pieces[0] - pieces[1]


def test_furniture_touches_nothing_in_the_simulator():
    model = build_model(TASKS.get("PickCube")().scenario)
    slots = [i for i in range(model.ngeom) if model.geom(i).name.startswith(f"{FURNITURE}_")]
    per_kind = {kind: sum(shapes.values()) for kind, shapes in PLACE_SHAPES.items()}
    assert len(slots) == 8 * per_kind["wall"] + 4 * per_kind["corner"]
    assert not model.geom_contype[slots].any() and not model.geom_conaffinity[slots].any()
    assert (model.geom_pos[slots, 2] < TASKS.get("PickCube")().scenario.floor_z).all()


def test_robots_and_tables_are_kept_free_without_any_camera():
    robot = RobotCfg(name="arm", mjcf="x:y.xml", root="base", joints=(), ee_site="hand", pos=(1.0, 0.0, 0.0))
    circles = keep_free(ScenarioCfg(robots=(robot,), table=TableCfg(half_size=(0.3, 0.4))))
    assert (circles[0].x, circles[0].radius) == (1.0, 0.95)
    assert circles[1].radius == pytest.approx(0.55)
