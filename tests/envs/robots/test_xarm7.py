"""The xArm7: its frames, with boxes in place of its meshes, and what is said where these are absent."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from envs.core.assets import ASSETS
from envs.core.errors import MissingAssetError
from envs.mjcf.layout import layout_of
from envs.mjcf.model import build_model
from envs.robots import ROBOTS
from envs.scenario import ScenarioCfg
from envs.tasks import fit_robot, kept_fits
from envs.tasks.fit_robot import fitted
from envs.tasks.make import make_task
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose

ROBOT = ROBOTS.get("xarm7")
SCENARIO = ScenarioCfg(robots=(ROBOT,), table=None, room=None)


def write_box(path: Path) -> None:
    """Writes a box of 2 cm as a binary STL."""
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * 0.01
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(faces), triangle)
    triangles["corners"] = corners[np.array(faces)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + np.uint32(len(faces)).tobytes() + triangles.tobytes())


@pytest.fixture
def absent(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("ROBOVERSE_DATA", str(tmp_path / "data"))


@pytest.fixture
def boxes(tmp_path, absent):
    for file in ASSETS.get("xarm7").needs:
        write_box(tmp_path / "data" / "xarm7" / file)


def flange(qpos):
    model = build_model(SCENARIO, simplify=False)
    data = mujoco.MjData(model)
    data.qpos[layout_of(model, SCENARIO).robots[0].qpos] = qpos
    mujoco.mj_kinematics(model, data)
    place = data.body("xarm7/right_hand")
    return place.xpos, place.xmat.reshape(3, 3)


def test_the_flange_at_zero_is_where_the_makers_is(boxes):
    """By the offsets of its links: 52.5 + 77.5 + 76 mm ahead, 267 + 293 - 342.5 - 97 mm up, pointing down."""
    pos, rot = flange(np.zeros(len(ROBOT.joints)))
    np.testing.assert_allclose(pos, [0.206, 0.0, 0.1205], atol=1e-6)
    np.testing.assert_allclose(rot, np.diag([1.0, -1.0, -1.0]), atol=1e-6)


def test_at_rest_the_hand_points_down(boxes):
    pos, rot = flange(ROBOT.default_qpos)
    assert pos[0] > 0.3 and abs(pos[1]) < 1e-6
    np.testing.assert_allclose(rot[:, 2], [0.0, 0.0, -1.0], atol=1e-3)


def test_an_absent_folder_is_named_before_a_collection_begins(absent, tmp_path):
    words = ["task=PickCube", "robot=xarm7", "num_demos=1", f"datasets_dir={tmp_path / 'datasets'}"]
    with pytest.raises(MissingAssetError, match="Download it with: roboverse assets get xarm7"):
        collect_dataset(compose("collect", words))
    assert not (tmp_path / "datasets").exists()


def test_an_absent_folder_is_no_verdict_about_the_arm(absent, tmp_path, monkeypatch):
    kept = tmp_path / "fits"
    kept.mkdir()
    monkeypatch.setattr(kept_fits, "cache_dir", lambda _: kept)
    fit_robot._fitted.cache_clear()
    with pytest.raises(MissingAssetError):
        fitted(make_task("PickCube"), ROBOT)
    assert not list(kept.iterdir())
