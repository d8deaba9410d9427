"""What every registered simulator promises of a robot whose base moves freely."""

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError, SimulatorError
from envs.rotations import rotate
from envs.simulators import HANDLERS
from envs.state import EntityState, State
from tests.contracts.walker import SCENARIO, WALKER, random_states

NUM_ENVS = 3
GRAVITY = 9.81


@pytest.fixture(scope="module", params=HANDLERS.names())
def handler(request):
    try:
        handler = HANDLERS.get(request.param)(SCENARIO, NUM_ENVS)
        handler.launch()
    except (MissingExtraError, SimulatorError) as error:
        pytest.skip(str(error))
    yield handler
    handler.close()


def assert_equal(states, expected):
    flat = states.flatten()
    for key, value in expected.flatten().items():
        if not key.endswith(("ee_pos", "ee_rot", "touched")):
            assert torch.equal(flat[key], value.to(flat[key])), key


def standing(height_m=0.45):
    rest = EntityState.at_rest(
        np.tile([0.0, 0.0, height_m], (NUM_ENVS, 1)),
        np.array([1.0, 0.0, 0.0, 0.0]),
        np.tile(WALKER.default_qpos, (NUM_ENVS, 1)),
    )
    return State({"walker": rest}, {})


def test_it_begins_where_the_robot_is_placed(handler):
    fresh = type(handler)(SCENARIO, 1)
    fresh.launch()
    robot = fresh.get_states().robots["walker"]
    assert robot.pos.tolist() == [pytest.approx(WALKER.pos)]
    assert robot.rot.tolist() == [list(WALKER.rot)]
    assert robot.joint_pos.tolist() == [pytest.approx(WALKER.default_qpos)]
    fresh.close()


def test_setting_and_getting_changes_no_bit(handler):
    states = random_states(0, NUM_ENVS)
    handler.set_states(states)
    assert_equal(handler.get_states(), states)
    part = random_states(1, 1)
    handler.set_states(part, [1])
    assert_equal(handler.get_states([1]), part)
    assert_equal(handler.get_states([0, 2]), states.select([0, 2]))


def test_states_are_copies(handler):
    handler.set_states(random_states(2, NUM_ENVS))
    before = handler.get_states()
    kept = {key: value.clone() for key, value in before.flatten().items()}
    handler.step(5)
    for key, value in before.flatten().items():
        assert torch.equal(value, kept[key]), key


def test_end_effector_moves_with_the_base(handler):
    states = random_states(3, NUM_ENVS)
    handler.set_states(states)
    robot = handler.get_states().robots["walker"]
    head = robot.pos + rotate(robot.rot, robot.pos.new_tensor([0.0, 0.0, 0.2]).expand_as(robot.pos))
    assert torch.allclose(robot.ee_pos, head, atol=1e-5)


def test_linear_velocity_is_the_worlds_and_angular_velocity_the_bodys(handler):
    """Over one short step the base moves as its velocities say."""
    states = random_states(4, NUM_ENVS, height_m=3.0)
    robot = states.robots["walker"]
    robot.ang_vel[:] = torch.tensor([0.0, 0.0, 2.0])
    handler.set_states(states)
    handler.step(1)
    after = handler.get_states().robots["walker"]
    dt = SCENARIO.physics.timestep_s
    moved = (after.pos.cpu().double() - robot.pos) / dt
    assert torch.allclose(moved, after.lin_vel.cpu().double(), atol=0.05)
    x_axis = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64).expand(NUM_ENVS, 3)
    turned = rotate(after.rot.cpu().double(), x_axis) - rotate(robot.rot, x_axis)
    # Turning about its own z moves the body's x axis along its y axis.
    y_axis = torch.tensor([0.0, 1.0, 0.0], dtype=torch.float64).expand(NUM_ENVS, 3)
    speed = after.ang_vel.cpu().double()[:, 2:]
    sideways = (turned * rotate(robot.rot, y_axis)).sum(-1, keepdim=True) / dt
    assert torch.allclose(sideways, speed, atol=0.1)


def test_it_falls_freely_and_the_ground_stops_it(handler):
    handler.set_states(standing(height_m=2.0))
    duration = 100 * SCENARIO.physics.timestep_s
    handler.step(100)
    fallen = 2.0 - handler.get_states().robots["walker"].pos[:, 2].cpu().double()
    assert torch.allclose(fallen, torch.full_like(fallen, 0.5 * GRAVITY * duration**2), rtol=0.05)
    handler.step(1500)
    robot = handler.get_states().robots["walker"]
    assert (robot.pos[:, 2] > 0.03).all()
    assert (robot.pos[:, 2] < 0.6).all()


def test_targets_are_clipped_to_the_actuators_range_in_the_scenarios_order(handler):
    handler.set_states(standing())
    handler.set_joint_targets({"walker": np.tile([9.0, -9.0], (NUM_ENVS, 1))})
    given = handler.get_states().robots["walker"].joint_target
    np.testing.assert_allclose(given.cpu(), np.tile([0.6, -0.8], (NUM_ENVS, 1)), rtol=1e-6)


def test_the_future_follows_from_the_state_alone(handler):
    start, ends = random_states(5, NUM_ENVS, height_m=0.6), []
    for _ in range(2):
        handler.set_states(start)
        handler.step(40)
        ends.append(handler.get_states())
        handler.set_states(random_states(6, NUM_ENVS))
        handler.step(7)
    assert_equal(ends[0], ends[1])


def test_floating_robot_is_rendered(handler):
    handler.set_states(standing())
    try:
        images = handler.render(None, ("segmentation",))["front"]["segmentation"]
    except SimulatorError as error:
        pytest.skip(str(error))
    assert handler.segmentation_names.index("walker") in images


def test_what_is_felt_touches_or_does_not(handler):
    handler.set_states(standing(height_m=1.0))
    handler.step(1)
    robot = handler.get_states().robots["walker"]
    if robot.touched is None:
        pytest.skip("this simulator reports no contacts; tasks that need them are refused")
    assert robot.touched.shape == (NUM_ENVS, 1)
    assert not robot.touched.any()
    handler.set_states(standing(height_m=0.42).select([0]), [1])
    handler.step(2)
    assert handler.get_states().robots["walker"].touched[:, 0].tolist() == [0.0, 1.0, 0.0]
    handler.set_states(standing(height_m=1.0))
    handler.step(1)
    assert not handler.get_states().robots["walker"].touched.any()
