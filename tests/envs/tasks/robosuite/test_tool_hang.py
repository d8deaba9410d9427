"""ToolHang: robosuite's shapes and starts, and its rule by hand."""

import importlib
import warnings

import numpy as np
import pytest
import torch

from envs.compat.mujoco4 import repair_robosuite
from envs.randomization.camera_poses import place_camera
from envs.rotations import from_matrix, from_yaw, multiply, rotate
from envs.tasks.robosuite import hook_stand as parts
from envs.tasks.robosuite.tool_hang import ToolHang
from tests.envs.tasks.table_states import assert_fills, starts, vector

TASK = ToolHang()
TURN = np.deg2rad(10.0)


def as_rows(*rows):
    return torch.tensor(np.array(rows, np.float64))


def hung(ring_from_end_m=0.03, below_m=0.005, frame_yaw=0.0):
    """A state in which all is done: the frame turned by 0 in the socket, the wrench hanging straight down."""
    state = starts(TASK)
    stand, frame, tool = (state.objects[name] for name in ("stand", "frame", "tool"))
    rot = from_yaw(np.array(frame_yaw))
    socket = stand.pos[0].numpy() + np.array([*parts.SOCKET_M, parts.SOCKET_FLOOR_M + 0.001])
    frame.pos, frame.rot = as_rows(socket - rotate(rot, np.array(parts.TIP))), as_rows(rot)
    # The wrench's x axis points down, its z axis along the bar.
    hanging = multiply(rot, from_matrix(np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])))
    end = frame.pos[0].numpy() + rotate(rot, np.array(parts.HOOK_END))
    ring = end + rotate(rot, np.array([ring_from_end_m, 0.0, -below_m]))
    tool.pos = as_rows(ring - rotate(hanging, np.array(parts.RING_POS)))
    tool.rot = as_rows(hanging)
    tool.touched[:], frame.touched[:] = torch.tensor([0.0, 1.0]), 1.0
    return state


def solved(state):
    found = TASK.success(state).tolist()
    assert TASK.success(state.arrays()).tolist() == found
    return found[0]


def test_shapes_weigh_what_robosuites_do():
    """Masses of its compiled model; the tip of ten blocks, not 51, weighs less by a millionth of a gram."""
    masses = {"stand": 8.76, "frame": 0.028954954, "tool": 0.178121202}
    for item in TASK.objects[:3]:
        geoms = [*item.geoms, *(geom for link in item.links for geom in link.geoms)]
        assert sum(geom.mass_kg for geom in geoms) == pytest.approx(masses[item.name], abs=1e-6)


def test_shapes_are_where_robosuites_model_has_them():
    """Numbers of its compiled model: walls, tip, ring."""
    walls = [[0.0, 0.0395, 0.005], [-0.0055, 0.045, 0.005], [0.0, 0.0505, 0.005], [0.0055, 0.045, 0.005]]
    assert np.allclose(parts.WALLS, walls)
    assert np.allclose(parts.TIP, [0.04375, 0.0, -0.13445])
    assert np.allclose(parts.RING_POS, [-0.09353, 0.0, 0.0], atol=5e-6)
    ring = TASK.objects[2].links[0].geoms
    assert np.allclose(ring[0].pos, [-0.01293, 0.0, 0.0], atol=5e-6)
    assert np.allclose(ring[1].pos, [-0.00915, 0.00915, 0.0], atol=5e-6)
    assert np.allclose(ring[1].rot, [0.38268, 0.0, 0.0, 0.92388], atol=5e-6)
    assert np.allclose(ring[0].size, [0.00323, 0.0067, 0.0035], atol=5e-6)


def test_things_start_in_robosuites_ranges():
    state = starts(TASK, 2000)
    stand, frame, tool = (state.objects[name] for name in ("stand", "frame", "tool"))
    assert torch.allclose(stand.pos, vector(-0.08, 0.0, 0.08)) and (stand.rot == vector(1, 0, 0, 0)).all()
    for entity, x, y in ((frame, -0.04, -0.24), (tool, 0.04, -0.2)):
        assert_fills(entity.pos[:, 0], x - 0.02, x + 0.02)
        assert_fills(entity.pos[:, 1], y - 0.02, y + 0.02)
    turn = 2 * torch.atan2(tool.rot[:, 3], tool.rot[:, 0])
    assert_fills(turn, np.deg2rad(-110) - TURN, np.deg2rad(-110) + TURN)


def test_the_frame_lies_as_robosuites_sampler_lays_it():
    """An orientation that it drew, wxyz: the rod's upper end points to -120.7 degrees, the y axis down."""
    theirs = np.array([0.18689, -0.18689, -0.68196, 0.68196])
    state = starts(TASK, 2000)
    rot = state.objects["frame"].rot.numpy()
    up = rotate(rot, np.tile([0.0, 0.0, 1.0], (2000, 1)))
    nearest = rot[np.argmax(np.abs(rot @ theirs))]
    assert abs(nearest @ theirs) == pytest.approx(1.0, abs=1e-5)
    headings = torch.from_numpy(np.arctan2(up[:, 1], up[:, 0]))
    assert_fills(headings, np.deg2rad(-120) - TURN, np.deg2rad(-120) + TURN)


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, -np.pi / 2, np.pi])
def test_a_wrench_on_an_assembled_frame_is_a_success(turn):
    assert solved(hung(frame_yaw=turn))


@pytest.mark.parametrize(
    ("from_end_m", "done"), [(0.0046, True), (0.0045, False), (0.0912, True), (0.0913, False)]
)
def test_the_ring_is_between_a_twentieth_and_the_whole_of_the_bar(from_end_m, done):
    """5 and 100 % of 91.25 mm: 4.5625 mm, 91.25 mm."""
    assert solved(hung(ring_from_end_m=from_end_m)) is done


@pytest.mark.parametrize(("below_m", "done"), [(0.0067, True), (0.0068, False)])
def test_the_ring_is_round_the_bar(below_m, done):
    """Inner radius less half the bar: 10.5 - 3.75 = 6.75 mm."""
    assert solved(hung(below_m=below_m)) is done


@pytest.mark.parametrize(("thing", "column"), [("tool", 1), ("frame", 0)])
def test_the_ring_touches_the_bar(thing, column):
    state = hung()
    state.objects[thing].touched[:, column] = 0.0
    assert not solved(state)


def test_the_robot_lets_go_of_the_wrench():
    state = hung()
    state.objects["tool"].touched[:, 0] = 1.0
    assert not solved(state)


@pytest.mark.parametrize(("lean", "done"), [(0.17, True), (0.18, False)])
def test_the_stand_is_upright(lean, done):
    """10 degrees are 0.1745 rad. All things lean together, about the stand."""
    state = hung()
    whole, middle = np.array([np.cos(lean / 2), 0.0, np.sin(lean / 2), 0.0]), state.objects["stand"].pos[0]
    for name in ("stand", "frame", "tool"):
        entity = state.objects[name]
        entity.pos = as_rows(middle.numpy() + rotate(whole, (entity.pos[0] - middle).numpy()))
        entity.rot = as_rows(multiply(whole, entity.rot[0].numpy()))
    assert solved(state) is done


@pytest.mark.parametrize(("up_m", "done"), [(0.015, True), (0.017, False)])
def test_the_tip_is_near_the_base(up_m, done):
    """45 mm aside, 5 mm + 1 mm + 15.79 mm above its middle are 50 mm."""
    state = hung()
    for name in ("frame", "tool"):
        state.objects[name].pos[:, 2] += up_m
    assert solved(state) is done


@pytest.mark.parametrize("aside", [(0.0, 0.0056), (0.0, -0.0056), (0.0056, 0.0), (-0.0056, 0.0)])
def test_the_rod_is_between_the_walls(aside):
    """Walls' middles are 5.5 mm from the socket's."""
    state, task = hung(), ToolHang(near_m=0.06)
    for share, done in ((1.0, False), (-0.05, True)):
        for name in ("frame", "tool"):
            state.objects[name].pos[:, :2] += share * torch.tensor(aside)
        assert task.success(state).tolist() == [done]


@pytest.fixture(scope="module")
def theirs():
    """robosuite's environment, without a renderer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # robosuite's escapes and absent optional parts
        suite = importlib.import_module("robosuite")
        repair_robosuite()
        found = suite.make(
            "ToolHang", robots="Panda", has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False
        )
        found.reset()
    found.sim.data.set_joint_qpos("robot0_joint1", 2.0)  # out of the way
    yield found
    found.close()


@pytest.mark.slow
def test_the_rule_is_robosuites(theirs):
    """States near the edges of what counts, in its environment and in ours; touches are as it finds them."""
    rng, counts = np.random.default_rng(0), {True: 0, False: 0}
    contact = importlib.import_module("robosuite.utils.sim_utils").check_contact
    ring = [f"tool_hole1_hc_{index}" for index in range(8)]
    for _ in range(300):
        state = hung(ring_from_end_m=rng.uniform(0.0, 0.1), below_m=rng.uniform(0.0055, 0.0069))
        for name, far in (("stand", 0.0), ("frame", 0.006), ("tool", 0.0)):
            entity = state.objects[name]
            entity.pos = entity.pos + as_rows(rng.uniform(-far, far, 3))
            where = [*(entity.pos[0] + torch.tensor([0.0, 0.0, 0.8])), *entity.rot[0]]
            theirs.sim.data.set_joint_qpos(f"{name}_joint0", np.array(where))
        theirs.sim.forward()
        touch = contact(theirs.sim, ring, "frame_horizontal_frame")
        state.objects["tool"].touched[:, 1], state.objects["frame"].touched[:, 0] = touch, touch
        assert TASK.assembled(state).tolist() == [theirs._check_frame_assembled()]
        assert TASK.hung(state).tolist() == [theirs._check_tool_on_frame()]
        counts[solved(state)] += 1
    assert min(counts.values()) > 20, counts


def test_reward_by_hand():
    """Things at their places and a far hand: 0.13 (3 + near + 0 + near)."""
    state = hung()
    tool, hand = state.objects["tool"].pos, vector(0.0, 0.0, 5.0)
    state.robots["franka"].ee_pos = hand
    ring = tool + vector(*(rotate(state.objects["tool"].rot[0].numpy(), np.array(parts.RING_POS))))
    frame = state.objects["frame"].pos + vector(*parts.PRONG)
    near = sum(1 - np.tanh(5 * float((a - b).norm())) for a, b in ((tool, hand), (ring, frame)))
    assert TASK.reward(state).item() == pytest.approx(0.13 * (3 + near))
    assert TASK.reward(starts(TASK)).item() < 0.2


def test_the_camera_sees_the_hung_wrench_from_the_side():
    """The bar points at the robot, along x; the line of sight is at least 45 degrees from it."""
    camera = TASK.scenario.cameras[0]
    sight = np.subtract(camera.look_at, camera.pos)
    assert abs(sight[0]) < np.sin(np.pi / 4) * np.linalg.norm(sight)
    assert np.allclose(camera.pos, place_camera(camera, "az+000-pol60").pos, atol=1e-3)
