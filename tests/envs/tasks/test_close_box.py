"""CloseBox's numbers, by hand, and its geometry against RoboVerse's facts."""

import math

import mujoco
import numpy as np
import pytest
import torch

from envs.core.errors import UnknownNameError
from envs.mjcf.model import build_model
from envs.rotations import rotate
from envs.simulators.mujoco.handler import MujocoHandler
from envs.state import EntityState
from envs.tasks.close_box import CLOSED_RAD, OPEN_RAD, CloseBox

BASE = torch.tensor(CloseBox().scenario.robots[0].pos, dtype=torch.float64)


def states(count=1):
    return CloseBox().initial_state([np.random.default_rng(i) for i in range(count)])


def test_initial_states_fill_the_ranges_of_the_demonstrations():
    state = states(2000)
    box = state.objects["box_base"]
    place = box.pos - BASE
    along = rotate(box.rot, torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(2000, 3))
    yaw = torch.atan2(-along[:, 0], along[:, 1])
    for values, low, high in (
        (place[:, 0], 0.437, 0.645),
        (place[:, 1], 0.044, 0.302),
        (yaw, -math.pi / 8, 0.221),
    ):
        assert low <= values.min() < low + 0.01 * (high - low)
        assert high >= values.max() > high - 0.01 * (high - low)
    assert (box.joint_pos == 2.3649210929871).all()
    home = torch.tensor(CloseBox().scenario.robots[0].default_qpos[:7], dtype=torch.float64)
    assert (state.robots["franka"].joint_pos[:, :7] - home).std() == pytest.approx(0.02, rel=0.05)


def test_an_orientation_of_the_recorded_demonstrations():
    """The first of RoboVerse's demonstrations has a yaw of 2 atan(0.01246 / 0.70700)."""
    recorded = torch.tensor([[0.706997, 0.0124625, -0.706997, 0.0124625]], dtype=torch.float64)
    up = rotate(recorded, torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(up, torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64), atol=1e-5, rtol=0)
    ours = states(50).objects["box_base"].rot
    up = rotate(ours, torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(50, 3))
    torch.testing.assert_close(up[:, 2], torch.ones(50, dtype=torch.float64))


@pytest.mark.parametrize(
    ("variant", "lid", "solved"),
    [
        # 2.36492 - 2.6 = -0.23508 rad: more than that has to be moved
        ("rlbench", -0.2350, False),
        ("rlbench", -0.2352, True),
        ("rlbench", OPEN_RAD, False),
        # -14° = -0.244346 rad
        ("roboverse", -0.2443, False),
        ("roboverse", -0.2444, True),
        ("rlbench", math.nan, False),
        ("roboverse", math.nan, False),
    ],
)
def test_success_is_a_lid_that_is_shut(variant, lid, solved):
    state = states()
    state.objects["box_base"].joint_pos[:] = lid
    assert CloseBox(variant=variant).success(state).tolist() == [solved]


def test_unknown_variant_lists_the_valid_ones():
    with pytest.raises(UnknownNameError, match=r"variant of CloseBox.*'robovers'.*roboverse"):
        CloseBox(variant="robovers")


def lid_corner(box, sign):
    """Returns the world position of the lid's geom as MuJoCo has it: middle, and along its length."""
    model = build_model(CloseBox().scenario)
    data = mujoco.MjData(model)
    mocap = model.body("box_base").mocapid[0]
    data.mocap_pos[mocap], data.mocap_quat[mocap] = box.pos[0].numpy(), box.rot[0].numpy()
    data.qpos[model.joint("box_base/box_joint").qposadr[0]] = float(box.joint_pos[0, 0])
    mujoco.mj_kinematics(model, data)
    geom = data.geom("box_base/box_joint")
    return geom.xpos + sign * geom.xmat.reshape(3, 3) @ [0.134, 0.0, 0.0], geom.xmat.reshape(3, 3)


def upright_box(lid):
    """A box at the origin whose y axis is the world's."""
    half = math.sqrt(0.5)
    return EntityState.at_rest(np.zeros((1, 3)), np.array([[half, 0.0, -half, 0.0]]), np.array([[lid]]))


def test_closed_lid_is_level_on_the_walls():
    """At -14.5° it is turned from the level by 0.5°; its lower face is where the walls end, 0.075 m."""
    tip, axes = lid_corner(upright_box(CLOSED_RAD), 1.0)
    root, _ = lid_corner(upright_box(CLOSED_RAD), -1.0)
    assert tip[1] - root[1] == pytest.approx(0.268, abs=1e-4)
    assert math.degrees(math.asin((tip[2] - root[2]) / 0.268)) == pytest.approx(0.5, abs=0.01)
    assert root[2] - 0.005 == pytest.approx(0.0755, abs=5e-4)
    # It covers the box from its hinge at y = -0.123 to beyond the far wall at 0.125.
    assert root[1] < -0.12 and tip[1] > 0.13
    assert abs(axes[2, 1]) > 0.999


def test_open_lid_is_beyond_the_vertical():
    """15° + 135.5° = 150.5° from the level: backwards, and 29.5° upwards."""
    tip, _ = lid_corner(upright_box(OPEN_RAD), 1.0)
    root, _ = lid_corner(upright_box(OPEN_RAD), -1.0)
    angle = math.degrees(math.atan2(tip[2] - root[2], tip[1] - root[1]))
    assert angle == pytest.approx(150.5, abs=0.05)


def test_reward_by_hand():
    """The reward of a half-closed lid is 0.75 / 2, plus 0.2 for a hand at the pushing point."""
    task, state = CloseBox(), states()
    state.objects["box_base"] = upright_box((OPEN_RAD + CLOSED_RAD) / 2)
    robot = state.robots["franka"]
    # 75.5° from the level, 0.25 m from the hinge and 2.02 cm outwards.
    angle = (OPEN_RAD + CLOSED_RAD) / 2 + math.radians(15.0)
    up = 0.076229 + 0.25 * math.sin(angle) + 0.0202 * math.cos(angle)
    back = -0.123002 + 0.25 * math.cos(angle) - 0.0202 * math.sin(angle)
    robot.ee_pos = torch.tensor([[0.0, back, up]], dtype=torch.float64)
    assert task.reward(state).item() == pytest.approx(0.375 + 0.2)
    robot.ee_pos += torch.tensor([0.5, 0.0, 0.0])
    assert task.reward(state).item() == pytest.approx(0.375 + 0.2 * 0.5)
    robot.ee_pos += torch.tensor([0.5, 0.0, 0.0])
    state.objects["box_base"] = upright_box(OPEN_RAD)
    assert 0.0 <= task.reward(state).item() < 0.01


def test_observation_shows_the_way_to_behind_the_lid():
    state = states()
    state.robots["franka"].ee_pos = torch.zeros((1, 3), dtype=torch.float64)
    observation = CloseBox().observe(state)
    assert observation.shape == (1, 15)
    assert observation[0, 7] == OPEN_RAD


def test_a_lid_let_go_beyond_the_vertical_falls_shut_and_stays():
    """As in the recordings: from 0.669 rad it is shut within 0.3 s; it does not bounce open."""
    handler = MujocoHandler(CloseBox().scenario, 1, num_threads=1)
    handler.launch()
    state = states()
    state.objects["box_base"].joint_pos[:] = 0.669
    handler.set_states(state)
    angles = []
    for _ in range(40):
        handler.step(25)
        angles.append(float(handler.get_states().objects["box_base"].joint_pos[0, 0]))
    handler.close()
    shut = next(index for index, angle in enumerate(angles) if angle <= -0.2444)
    assert shut <= 5
    assert max(angles[shut:]) < -0.2444


def test_no_initial_state_touches_the_box():
    handler = MujocoHandler(CloseBox().scenario, 200, num_threads=1)
    handler.launch()
    handler.set_states(states(200))
    data = mujoco.MjData(handler.model)
    for job in handler.snapshot():
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = job.qpos, job.mocap_pos, job.mocap_quat
        mujoco.mj_forward(handler.model, data)
        bodies = handler.model.geom_bodyid[np.array([c.geom for c in data.contact[: data.ncon]], int)]
        names = {handler.model.body(body).name.split("/")[0] for body in np.ravel(bodies)}
        assert "box_base" not in names
    handler.close()


def test_the_open_lid_stays_open():
    handler = MujocoHandler(CloseBox().scenario, 1, num_threads=1)
    handler.launch()
    handler.set_states(states())
    handler.step(2500)
    assert float(handler.get_states().objects["box_base"].joint_pos[0, 0]) == pytest.approx(
        OPEN_RAD, abs=2e-3
    )
    handler.close()
