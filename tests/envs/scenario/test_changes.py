"""A scene with some of its values replaced: what is taken, what is refused and how, what stays."""

import json
from dataclasses import replace
from typing import Any

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from envs.scenario import LightCfg, PhysicsCfg, ScenarioCfg
from envs.scenario.changes import changed, difference, keys_of, merged
from envs.tasks.make import make_task

SCENE = make_task("PickCube").scenario


def test_nothing_changed_is_the_same_scene() -> None:
    assert changed(SCENE, {}) == SCENE


def test_what_is_not_named_stays_as_it_is() -> None:
    new = changed(SCENE, {"physics": {"decimation": 50}})
    assert new == replace(SCENE, physics=replace(SCENE.physics, decimation=50))
    assert new.physics.control_hz == 10.0


def test_a_camera_is_chosen_by_its_name_and_a_light_by_its_place() -> None:
    new = changed(
        SCENE,
        {
            "cameras": {"wrist": {"fovy_deg": 50, "pos": [0.1, 0, 0.05]}},
            "appearance": {"lights": {"0": {"intensity": 0.5}}, "materials": {"table": {"roughness": 0.25}}},
        },
    )
    front, wrist = new.cameras
    assert front == SCENE.cameras[0]
    assert wrist == replace(SCENE.cameras[1], fovy_deg=50.0, pos=(0.1, 0.0, 0.05))
    assert new.appearance.lights[0].intensity == 0.5
    assert new.appearance.materials["table"].roughness == 0.25
    assert new.appearance.materials["wall"] == SCENE.appearance.materials["wall"]


def test_lights_can_be_given_whole() -> None:
    new = changed(SCENE, {"appearance": {"lights": [{"kind": "area", "pos": [0, 0, 3]}, {}]}})
    assert new.appearance.lights == (LightCfg(kind="area", pos=(0.0, 0.0, 3.0)), LightCfg())


def test_lamps_objects_and_robots_have_keys_too() -> None:
    new = changed(
        SCENE,
        {
            "lighting": {"array_shape": [3, 4]},
            "objects": {"cube": {"geoms": {"0": {"mass_kg": 0.5}}}},
            "robots": {"franka": {"joints": {"joint1": {"kp": 1000}}}},
        },
    )
    assert new.lighting.num_lamps == 12
    assert new.object("cube").geoms[0].mass_kg == 0.5
    assert new.robots[0].joints[0].kp == 1000.0


def test_the_room_can_be_left_out_and_nothing_of_it_changed_then() -> None:
    bare = changed(SCENE, {"room": None})
    assert bare.room is None
    with pytest.raises(ConfigError, match=r"scenario\.room: this task's scene has none"):
        changed(bare, {"room": {"height_m": 3}})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"physics": {"decimaton": 5}}, r"key of scenario\.physics 'decimaton'\. Did you mean 'decimation'"),
        ({"phisics": {}}, r"key of scenario 'phisics'\. Did you mean 'physics'"),
        (
            {"cameras": {"frnt": {}}},
            r"key of scenario\.cameras 'frnt'\. Did you mean 'front'\? Valid: front, w",
        ),
        (
            {"cameras": {"front": {"fov_deg": 3}}},
            r"key of scenario\.cameras\.front 'fov_deg'\. Did you mean 'fovy_deg'",
        ),
        ({"cameras": {"front": {"name": "x"}}}, r"key of scenario\.cameras\.front 'name'"),
        ({"simulators": {"mujoco": {}}}, r"key of scenario 'simulators'"),
        ({"appearance": {"lights": {"1": {}}}}, r"key of scenario\.appearance\.lights '1'\. Valid: 0"),
        ({"appearance": {"lights": [{"colour": 1}]}}, r"lights\.0 'colour'\. Did you mean 'color'"),
    ],
)
def test_an_unknown_key_suggests_the_nearest(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(UnknownNameError, match=message):
        changed(SCENE, changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"physics": {"decimation": 0}},
            "decimation, physics steps per control step, must be at least 1, given 0",
        ),
        ({"physics": {"decimation": 2.5}}, r"scenario\.physics\.decimation: input should be .* given 2\.5"),
        ({"physics": {"timestep_s": -1}}, r"timestep_s must be above 0 s, given -1\.0"),
        (
            {"physics": {"timestep_s": float("nan")}},
            r"timestep_s: input should be a finite number, given nan",
        ),
        (
            {"physics": 20},
            r"scenario\.physics has keys of its own \(timestep_s, decimation, gravity\); given 20",
        ),
        ({"cameras": []}, r"scenario\.cameras is changed one by one \(front, wrist\), .*; given \[\]\."),
        ({"cameras": {"front": {"up": [0, 0, 0]}}}, r"CameraCfg\.up is a direction, given \(0\.0, 0"),
        ({"appearance": {"lights": {"0": {"direction": [0, 0, 0]}}}}, r"LightCfg\.direction is a direction"),
        ({"appearance": {"object_reflection": [1, 2, 0]}}, r"each within 0 to 1, given \(1\.0, 2\.0, 0\.0\)"),
        ({"ground_half_size_m": 0}, r"ground_half_size_m must be above 0 m, given 0"),
        (
            {"cameras": {"front": 3}},
            r"front has keys of its own \(pos, look_at, .*; given 3",
        ),
        ({"cameras": {"front": {"pos": [1, 0]}}}, r"scenario\.cameras\.front\.pos\.2: field required"),
        (
            {"cameras": {"front": {"fovy_deg": 180}}},
            r"fovy_deg is an angle above 0 and below 180 degrees, given 180\.0",
        ),
        ({"cameras": {"front": {"look_at": [1.299, 0, 0.75]}}}, "'front' is where it looks at"),
        ({"lighting": {"array_shape": [0, 3]}}, r"array_shape is two positive counts, given \(0, 3\)"),
        ({"lighting": {"array_shape": [10, 10]}}, r"at most 99 lamps in all, given \(10, 10\)"),
        (
            {"lighting": {"temperature_k": [1000, 5000]}},
            "temperature_k must be within 1667 to 25000 K, given",
        ),
        ({"appearance": {"materials": {"wall": {"metallic": 2}}}}, r"metallic is within 0 to 1, given 2\.0"),
        ({"appearance": {"lights": [{"intensity": -1}]}}, r"LightCfg\.intensity must be 0 or more, given -1"),
        ({"room": {"height_m": 0}}, r"RoomCfg\.height_m must be above 0 m, given 0"),
        ({"table": {"half_size": [1, 0]}}, r"TableCfg\.half_size is two lengths above 0 m"),
        ({"objects": {"cube": {"kind": "fre"}}}, r"scenario\.objects\.cube\.kind: input should be 'free'"),
    ],
)
def test_a_wrong_value_says_which_and_what_is_valid(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        changed(SCENE, changes)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"physics": {"decimation": 50, "gravity": [0, 0, -1]}, "room": None},
        {"cameras": {"wrist": {"fovy_deg": 50, "mount": None}}, "lighting": {"array_shape": [3, 4]}},
        {"objects": {"cube": {"geoms": {"0": {"mass_kg": 0.5}}}}, "ground_half_size_m": 3},
        {
            "appearance": {
                "materials": {"table": {"texture": "wood-017"}},
                "lights": {"0": {"intensity": 0.5}},
            }
        },
    ],
)
def test_the_difference_is_what_was_changed(changes: dict[str, Any]) -> None:
    assert difference(SCENE, changed(SCENE, changes)) == changes


@pytest.mark.parametrize("lights", [[], [{"kind": "area"}, {}]])
def test_a_row_of_another_length_differs_as_a_whole(lights: list[Any]) -> None:
    new = changed(SCENE, {"appearance": {"lights": lights}})
    changes = difference(SCENE, new)
    assert changed(SCENE, json.loads(json.dumps(changes))) == new
    assert len(changes["appearance"]["lights"]) == len(lights)


def test_what_is_set_to_what_it_was_is_no_difference() -> None:
    same = {"physics": {"decimation": 25.0}, "cameras": {"front": {}}, "table": {}, "appearance": {}}
    assert difference(SCENE, changed(SCENE, same)) == {}


def test_later_changes_win_and_earlier_ones_stay() -> None:
    first = {"physics": {"decimation": 50, "timestep_s": 0.001}, "room": None}
    later = {"physics": {"decimation": 5}, "cameras": {"front": {"fovy_deg": 30}}}
    assert merged(first, later) == {
        "physics": {"decimation": 5, "timestep_s": 0.001},
        "room": None,
        "cameras": {"front": {"fovy_deg": 30}},
    }
    assert first["physics"]["decimation"] == 50


def test_every_key_of_a_scene_is_known_by_name() -> None:
    keys = {key: (cls, name) for key, cls, name in keys_of(ScenarioCfg, "scenario")}
    assert keys["scenario.physics.decimation"] == (PhysicsCfg, "decimation")
    assert {"scenario.cameras.<name>.pos", "scenario.appearance.lights.<number>.intensity"} <= set(keys)
    assert "scenario.room.height_m" in keys and "scenario.cameras.<name>.name" not in keys
