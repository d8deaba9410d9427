"""MoveSliderLeft's numbers, by hand; with CALVIN's meshes where they are at hand."""

import math
import os
import re
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import ConfigError, MissingExtraError, UnknownNameError
from envs.core.extras import install_command
from envs.mjcf.model import build_model
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks import calvin_meshes
from envs.tasks.move_slider import BLOCKS, MoveSliderLeft

DATA = Path(os.environ.get("ROBOVERSE_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))
CALVIN = DATA / "calvin_env_data"


def states(count=1):
    return MoveSliderLeft().initial_state([np.random.default_rng(i) for i in range(count)])


@pytest.fixture
def calvin_dir():
    if not (CALVIN / "data" / calvin_meshes.URDF).is_file():
        pytest.skip(f"{CALVIN} is absent; set ROBOVERSE_DATA to the folder of CALVIN's data.")
    pytest.importorskip("coacd")
    return str(CALVIN)


@pytest.mark.parametrize(
    ("variant", "slide", "solved"),
    [
        ("calvin", 0.1499, False),
        ("calvin", 0.15, False),
        ("calvin", 0.1501, True),
        ("roboverse", 0.0699, False),
        ("roboverse", 0.07, True),
        ("calvin", math.nan, False),
        ("roboverse", math.nan, False),
    ],
)
def test_success_is_how_far_the_door_has_moved(variant, slide, solved):
    state = states()
    state.objects["play_table"].joint_pos[:, 0] = slide
    assert MoveSliderLeft(variant=variant).success(state).tolist() == [solved]


def test_other_joints_do_not_count():
    state = states()
    state.objects["play_table"].joint_pos[:, 1:] = 0.2
    assert not MoveSliderLeft().success(state).any()


def test_the_joints_are_calvins_at_its_scale():
    table = MoveSliderLeft().scenario.object("play_table")
    assert table.joint_names == ("base__slide", "base__drawer", "base__button", "base__switch")
    travels = [link.joint.range[1] for link in table.links]
    np.testing.assert_allclose(travels, [0.28, 0.22, 0.02, 0.088])


def test_initial_states_do_not_overlap():
    state = states(1000)
    table = state.objects["play_table"].joint_pos
    assert (table[:, [0, 2]] == 0.0).all()
    assert 0.0 <= table[:, 1].min() < 0.003 and 0.217 < table[:, 1].max() <= 0.22
    assert 0.0 <= table[:, 3].min() < 0.001 and 0.087 < table[:, 3].max() <= 0.088
    blocks = {name: state.objects[name].pos for name in BLOCKS}
    radii = {"block_pink": 0.0283, "block_blue": 0.0448, "block_red": 0.0345}
    for first, second in (
        ("block_pink", "block_blue"),
        ("block_pink", "block_red"),
        ("block_blue", "block_red"),
    ):
        gap = torch.linalg.vector_norm(blocks[first] - blocks[second], dim=-1)
        assert gap.min() > radii[first] + radii[second]
    for pos in blocks.values():
        assert (pos[:, 2] == 0.02).all()
        # The desk ends at y = -0.18; button and switch panel stand at the ends of the range in x.
        assert pos[:, 1].min() >= -0.135 and pos[:, 1].max() <= -0.052
        assert pos[:, 0].min() >= -0.19 and pos[:, 0].max() <= 0.33
        assert pos[:, 0].std() > 0.1


def touching(handler):
    """Names of the things, robots' own links aside, that overlap in a state of the handler, with depths."""
    model, data, found = handler.model, mujoco.MjData(handler.model), {}
    for job in handler.snapshot():
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = job.qpos, job.mocap_pos, job.mocap_quat
        mujoco.mj_forward(model, data)
        for contact in data.contact[: data.ncon]:
            pair = tuple(model.body(model.geom_bodyid[geom]).name.split("/")[0] for geom in contact.geom)
            if pair != ("franka", "franka"):
                found[pair] = min(found.get(pair, 0.0), float(contact.dist))
    return found


def test_nothing_overlaps_in_an_initial_state():
    with MujocoHandler(MoveSliderLeft().scenario, 200, num_threads=1) as handler:
        handler.launch()
        handler.set_states(states(200))
        assert all(depth > -1e-6 for depth in touching(handler).values()), touching(handler)


def resting(task, count=6):
    """Returns how far joints of the table and blocks move in 5 s by themselves."""
    with MujocoHandler(task.scenario, count, num_threads=1) as handler:
        handler.launch()
        before = states(count)
        handler.set_states(before)
        handler.step(2500)
        after = handler.get_states()
    joints = (after.objects["play_table"].joint_pos - before.objects["play_table"].joint_pos).abs().max()
    blocks = [(after.objects[name].pos - before.objects[name].pos).abs().max() for name in BLOCKS]
    return float(joints), float(max(blocks))


@pytest.mark.slow
def test_door_drawer_button_and_switch_stay_where_they_are():
    joints, blocks = resting(MoveSliderLeft())
    assert joints < 1e-3
    assert blocks < 1e-3


def handle_in_mujoco(slide):
    model = build_model(MoveSliderLeft().scenario)
    data = mujoco.MjData(model)
    data.qpos[model.joint("play_table/base__slide").qposadr[0]] = slide
    mujoco.mj_kinematics(model, data)
    return data.geom("play_table/base__slide/1").xpos


@pytest.mark.parametrize("slide", [0.0, 0.2])
def test_the_way_to_the_handle_ends_at_its_bar(slide):
    """URDF: (-.125, .09375, .66908) + Rx(60°) (.175, 0, .0875), at 0.8, and 0.44 m lower: x is 0.04."""
    task, state = MoveSliderLeft(), states()
    state.objects["play_table"].joint_pos[:, 0] = slide
    state.robots["franka"].ee_pos = torch.zeros((1, 3), dtype=torch.float64)
    handle = task.observe(state)[0, 3:6].numpy()
    expected = [
        0.04 - slide,
        0.8 * (0.09375 - 0.0875 * math.sin(math.pi / 3)),
        0.8 * (0.66908 + 0.0875 * 0.5) - 0.44,
    ]
    np.testing.assert_allclose(handle, expected, atol=1e-9)
    np.testing.assert_allclose(handle, handle_in_mujoco(slide), atol=1e-6)


def test_reward_by_hand():
    """The reward of a hand at the handle is 0.2, that of half of 15 cm 0.375."""
    task, state = MoveSliderLeft(), states()
    robot = state.robots["franka"]
    robot.ee_pos = torch.zeros((1, 3), dtype=torch.float64)
    robot.ee_pos = task.observe(state)[:, 3:6]
    assert task.reward(state).item() == pytest.approx(0.2)
    state.objects["play_table"].joint_pos[:, 0] = 0.075
    robot.ee_pos[:, 0] -= 0.075
    assert task.reward(state).item() == pytest.approx(0.575)
    assert MoveSliderLeft(variant="roboverse").reward(state).item() == pytest.approx(0.95)


def test_unknown_variant_lists_the_valid_ones():
    with pytest.raises(UnknownNameError, match=r"variant of MoveSliderLeft.*'calvim'.*calvin"):
        MoveSliderLeft(variant="calvim")


def test_folder_without_the_table_is_an_error_that_names_the_file(tmp_path):
    with pytest.raises(
        ConfigError, match=r"holds no calvin_table_A/urdf/calvin_table_A\.urdf.*Give the folder"
    ):
        _ = MoveSliderLeft(calvin_dir=str(tmp_path)).scenario


def test_without_coacd_the_error_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path))
    monkeypatch.setitem(sys.modules, "coacd", None)
    mesh = tmp_path / "mesh.obj"
    mesh.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n")
    with pytest.raises(MissingExtraError, match=re.escape(install_command("calvin"))):
        calvin_meshes._decomposed(mesh)
    assert not any((tmp_path / "calvin").iterdir())


def test_a_piece_is_cut_off_at_the_desk_if_it_rises_above_it_by_a_little():
    below = np.array([[0.0, 0.0, 0.5], [1.0, 0.0, 0.55], [0.0, 1.0, 0.555]])
    np.testing.assert_array_equal(calvin_meshes._level(below)[:, 2], [0.5, 0.55, 0.55])
    for others in ([0.555, 0.575, 0.56], [0.5, 0.55, 0.8], [0.545, 0.55, 0.555]):
        piece = np.column_stack([below[:, :2], others])
        np.testing.assert_array_equal(calvin_meshes._level(piece), piece)


def test_objects_of_a_file_become_files_that_are_made_once(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path / "cache"))
    corner = "v {0} 0 0\nv {1} 0 0\nv {0} 1 0\nv {0} 0 1\n"
    faces = "f {0} {2} {1}\nf {0} {1} {3}\nf {1} {2} {3}\nf {0} {3} {2}\n"
    parts = [
        f"o part_{i}\n" + corner.format(2 * i, 2 * i + 1) + faces.format(*range(4 * i + 1, 4 * i + 5))
        for i in range(2)
    ]
    file = tmp_path / "parts.obj"
    file.write_text("".join(parts))
    pieces = calvin_meshes._split(file)
    assert [piece.name for piece in pieces] == ["000.stl", "001.stl"]
    stamps = [piece.stat().st_mtime_ns for piece in pieces]
    assert [piece.stat().st_mtime_ns for piece in calvin_meshes._split(file)] == stamps


@pytest.mark.slow
def test_calvins_meshes_have_the_dimensions_of_the_boxes(calvin_dir):
    """Bounds of everything visible, and of every moving part, agree within a centimetre."""
    boxes, meshes = MoveSliderLeft(), MoveSliderLeft(calvin_dir=calvin_dir)
    first, second = (bounds(build_model(task.scenario)) for task in (boxes, meshes))
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_allclose(first[name], second[name], atol=0.01, err_msg=name)


def bounds(model):
    """Body of the table to least and largest corner of what is touched of it."""
    data, found = mujoco.MjData(model), {}
    mujoco.mj_kinematics(model, data)
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if name.startswith("play_table/") and model.geom_contype[geom]:
            middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
            turn = data.geom_xmat[geom].reshape(3, 3)
            at, reach = data.geom_xpos[geom] + turn @ middle, np.abs(turn) @ half
            low, high = found.get(name, (np.full(3, np.inf), np.full(3, -np.inf)))
            found[name] = (np.minimum(low, at - reach), np.maximum(high, at + reach))
    return found


@pytest.mark.slow
def test_calvin_meshes_stay_at_rest(calvin_dir):
    joints, blocks = resting(MoveSliderLeft(calvin_dir=calvin_dir))
    assert joints < 1e-3
    assert blocks < 1e-3
