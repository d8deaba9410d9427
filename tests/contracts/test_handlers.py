"""What every registered simulator promises, on one small scene."""

import dataclasses

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError, SimulatorError, UnknownNameError
from envs.simulators import HANDLERS
from envs.simulators.base import Handler
from envs.simulators.hybrid import HybridHandler
from envs.tasks.pick_cube import PickCube

NUM_ENVS = 4
PAIRS = [f"mujoco+{name}" for name in HANDLERS if name != "mujoco"]
"""Physics that is exact, with the images of every other simulator."""


def make(name, scenario, num_envs):
    """A simulator, or physics of one and images of another: ``mujoco+sapien``."""
    physics, _, drawing = name.partition("+")
    try:
        if drawing:
            return HybridHandler(scenario, num_envs, simulator=physics, renderer=drawing)
        return HANDLERS.get(physics)(scenario, num_envs)
    except MissingExtraError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module", params=[*HANDLERS.names(), *PAIRS])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def handler(name):
    scenario = PickCube().scenario
    cameras = tuple(dataclasses.replace(camera, width=32, height=32) for camera in scenario.cameras)
    with make(name, dataclasses.replace(scenario, cameras=cameras), NUM_ENVS) as handler:
        handler.launch()
        yield handler


def random_states(seed: int, count: int = NUM_ENVS):
    """Random states: joints, poses, velocities, targets."""
    rng = np.random.default_rng(seed)
    states = PickCube().initial_state([np.random.default_rng(seed + i) for i in range(count)])
    for entity in states.entities().values():
        entity.rot = torch.from_numpy(normalized(rng.normal(size=(count, 4))))
    cube, robot = states.objects["cube"], states.robots["franka"]
    cube.pos[:, 2] += 0.3
    cube.lin_vel[:] = torch.from_numpy(rng.normal(size=(count, 3)))
    cube.ang_vel[:] = torch.from_numpy(rng.normal(size=(count, 3)))
    robot.joint_vel[:] = torch.from_numpy(0.1 * rng.normal(size=(count, 9)))
    robot.joint_target = robot.joint_pos + 0.01
    robot.joint_target[:, 7:] = 0.02
    return states


def normalized(q):
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def assert_equal(states, expected, *, but=("ee_pos", "ee_rot")):
    """Bit-identical, once ``expected`` is rounded to the precision of the simulator's states."""
    flat = states.flatten()
    for key, value in expected.flatten().items():
        name, field = key.split("/")[1:]
        fixed = name == "franka" and field in ("pos", "rot", "lin_vel", "ang_vel")
        still = name == "goal" and field.endswith("_vel")
        if field not in but and not fixed and not still:
            assert torch.equal(flat[key], value.to(flat[key])), key


def test_setting_and_getting_changes_no_bit(handler):
    states = random_states(0)
    handler.set_states(states)
    assert_equal(handler.get_states(), states)


def test_states_have_the_simulators_precision_and_what_was_got_can_be_set(handler):
    handler.set_states(random_states(0))
    handler.step(2)
    states = handler.get_states()
    for key, value in states.flatten().items():
        assert value.dtype == handler.dtype, key
        assert value.device == handler.device, key
    handler.set_states(random_states(1))
    handler.set_states(states)
    assert_equal(handler.get_states(), states)


def test_a_subset_is_neither_stale_nor_mixed_up(handler):
    handler.set_states(random_states(1))
    part = random_states(2, 2)
    handler.set_states(part, [1, 3])
    assert_equal(handler.get_states([1, 3]), part)
    everything = handler.get_states()
    assert_equal(everything.select([1, 3]), part)
    assert_equal(everything.select([0, 2]), random_states(1).select([0, 2]))
    handler.step(3, [0])
    later = handler.get_states()
    assert_equal(later.select([1, 2, 3]), everything.select([1, 2, 3]))
    assert not torch.equal(later.objects["cube"].pos[0], everything.objects["cube"].pos[0])


def test_environments_are_named_by_a_list_an_array_or_a_tensor_where_the_states_are(handler):
    some, found = [0, 2], []
    for ids in (some, np.array(some), torch.tensor(some, device=handler.device)):
        handler.set_states(random_states(3).to(handler.device, handler.dtype))
        handler.set_states(random_states(4).select(some).to(handler.device, handler.dtype), ids)
        handler.step_towards({"franka": handler.get_joint_targets("franka", ids)}, 2, ids)
        handler.step(2, ids)
        found.append((handler.get_states(ids).flatten(), handler.snapshot(ids)))
    (first, jobs), *others = found
    for states, snapshots in others:
        assert len(snapshots) == len(jobs) == len(some)
        assert all(torch.equal(states[key], value) for key, value in first.items())


def test_states_are_copies(handler):
    handler.set_states(random_states(3))
    before = handler.get_states()
    kept = {key: value.clone() for key, value in before.flatten().items()}
    handler.step(5)
    for key, value in before.flatten().items():
        assert torch.equal(value, kept[key]), key


def test_the_future_follows_from_the_state_alone(handler):
    start, ends = random_states(4), []
    for _ in range(2):
        handler.set_states(start)
        handler.step(40)
        ends.append(handler.get_states())
        handler.set_states(random_states(5))
        handler.step(7)
    assert_equal(ends[0], ends[1], but=())


def test_environments_do_not_touch_each_other(handler):
    start = random_states(6)
    handler.set_states(start)
    handler.step(20)
    together = handler.get_states()
    handler.set_states(random_states(7))
    handler.set_states(start.select([2]), [0])
    handler.step(20, [0])
    assert_equal(handler.get_states([0]), together.select([2]), but=())


@pytest.mark.slow
def test_joints_go_to_their_targets_in_the_scenarios_order(handler):
    states = PickCube().initial_state([np.random.default_rng(i) for i in range(NUM_ENVS)])
    handler.set_states(states)
    target = states.robots["franka"].joint_pos.clone()
    target += torch.tensor([0.1, -0.1, 0.15, 0.1, -0.15, 0.1, 0.2, -0.01, -0.01])
    handler.set_joint_targets({"franka": target})
    given = handler.get_states().robots["franka"].joint_target
    assert torch.equal(given, target.to(given))
    handler.step(1500)
    reached = handler.get_states().robots["franka"].joint_pos.cpu()
    assert (reached - target).abs().max() < 5e-3


def test_targets_that_move_evenly_are_there_in_the_last_step(handler):
    """An arm follows the same path by targets of one call and by targets of each step."""
    start = handler.get_states()
    goal = start.robots["franka"].joint_pos.cpu().numpy() + 0.02
    goal[:, 7:] = 0.03  # inside of the fingers' range
    handler.set_states(start)  # simulators warm-start from the step before, which this resets
    handler.step_towards({"franka": goal}, 4)
    together = handler.get_states()
    handler.set_states(start)
    Handler.step_towards(handler, {"franka": goal}, 4)
    apart = handler.get_states()
    np.testing.assert_array_equal(
        together.robots["franka"].joint_target.cpu(), apart.robots["franka"].joint_target.cpu()
    )
    np.testing.assert_allclose(
        together.robots["franka"].joint_pos.cpu(), apart.robots["franka"].joint_pos.cpu(), atol=1e-5
    )
    handler.set_states(start)
    handler.step_towards({"franka": goal[:1]}, 4, [0])
    alone = handler.get_states()
    np.testing.assert_array_equal(
        alone.robots["franka"].joint_pos[0].cpu(), together.robots["franka"].joint_pos[0].cpu()
    )
    np.testing.assert_array_equal(
        alone.robots["franka"].joint_pos[1:].cpu(), start.robots["franka"].joint_pos[1:].cpu()
    )


def test_targets_are_clipped_to_the_joints_ranges(handler):
    handler.set_joint_targets({"franka": np.full((1, 9), 10.0)}, [2])
    high = [joint.range[1] for joint in handler.scenario.robots[0].joints]
    given = handler.get_states([2]).robots["franka"].joint_target[0]
    np.testing.assert_allclose(given.cpu(), high, rtol=1e-7)


def test_a_falling_body_obeys_gravity(handler):
    states = random_states(8)
    for entity in states.objects.values():
        entity.lin_vel[:] = 0.0
        entity.ang_vel[:] = 0.0
    states.objects["cube"].pos[:] = torch.tensor([1.5, 1.5, 3.0])
    handler.set_states(states)
    duration = 100 * handler.scenario.physics.timestep_s
    handler.step(100)
    fallen = 3.0 - handler.get_states().objects["cube"].pos[:, 2].cpu()
    assert torch.allclose(fallen, torch.full_like(fallen, 0.5 * 9.81 * duration**2), rtol=0.02)


def test_unknown_names_are_refused(handler):
    states = random_states(9)
    states.objects["kube"] = states.objects.pop("cube")
    with pytest.raises(UnknownNameError, match=r"Unknown robot or object 'kube'.*Did you mean 'cube'"):
        handler.set_states(states)
    with pytest.raises(UnknownNameError, match=r"Unknown camera 'frnt'.*Did you mean 'front'"):
        handler.render(["frnt"])
    with pytest.raises(UnknownNameError, match=r"Unknown modality 'colour'.*Valid: depth, rgb, segmentation"):
        handler.render(["front"], ["colour"])


def test_images_have_the_right_shape_and_show_the_scene(handler):
    handler.set_states(PickCube().initial_state([np.random.default_rng(i) for i in range(NUM_ENVS)]))
    try:
        images = handler.render(None, ("rgb", "depth", "segmentation"), [0, 2])["front"]
    except SimulatorError as error:
        pytest.skip(str(error))
    assert images["rgb"].shape == (2, 32, 32, 3)
    assert images["rgb"].dtype == np.uint8
    assert images["depth"].dtype == np.float32
    names = handler.segmentation_names
    seen = {names[i] for i in np.unique(images["segmentation"]) if i >= 0}
    assert {"franka", "table"} <= seen
    distance = np.linalg.norm(np.subtract(handler.scenario.cameras[0].pos, (0, 0, 0.12)))
    assert 0.5 * distance < np.median(images["depth"]) < 2.0 * distance


def test_closing_twice_is_harmless(name, handler):
    other = make(name, handler.scenario, 1)
    other.launch()
    other.close()
    other.close()
