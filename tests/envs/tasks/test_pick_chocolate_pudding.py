"""PickChocolatePudding's numbers, by hand; and LIBERO's own files, where they are at hand."""

import itertools
import math
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import ConfigError, UnknownNameError
from envs.rotations import from_euler, to_matrix
from envs.simulators.mujoco.handler import MujocoHandler
from envs.tasks.libero_objects import GROCERIES, libero_root, read_init_states, rest_height
from envs.tasks.pick_chocolate_pudding import (
    CONTAIN_CENTRE_M,
    HOME,
    REGIONS,
    PickChocolatePudding,
    _distance_to_hand,
)
from envs.tasks.waypoint_planner import WaypointPlanner

DATA = Path(os.environ.get("ROBOVERSE_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))
LIBERO = DATA / "libero_object_chocolate"
needs_libero = pytest.mark.skipif(not LIBERO.is_dir(), reason=f"no copy of LIBERO's files in {LIBERO}")


def states(count=1, **options):
    return PickChocolatePudding(**options).initial_state([np.random.default_rng(i) for i in range(count)])


def test_initial_states_fill_the_regions():
    state = states(1500)
    for name, (middle, half) in REGIONS.items():
        pos = state.objects[name].pos
        for axis in range(2):
            low, high = middle[axis] - half, middle[axis] + half
            assert low <= pos[:, axis].min() < low + 0.02 * half
            assert high >= pos[:, axis].max() > high - 0.02 * half
        assert (pos[:, 2] == pos[0, 2]).all()
    arm = state.robots["franka"].joint_pos[:, :7] - torch.tensor(HOME[:7])
    assert arm.std() == pytest.approx(0.02, rel=0.05)
    assert (state.robots["franka"].joint_pos[:, 7:] == 0.020833).all()


def test_no_two_objects_overlap():
    """The circles round their outlines, from above, are apart in every draw."""
    state = states(1500)
    radii = {item.name: item.radius_m for item in GROCERIES}
    for a, b in itertools.combinations(REGIONS, 2):
        apart = torch.linalg.vector_norm(state.objects[a].pos[:, :2] - state.objects[b].pos[:, :2], dim=-1)
        assert apart.min() > radii[a] + radii[b] + 0.0079, (a, b)


def test_outlines_and_heights_of_the_primitives():
    """The pudding: box (.0401, .02316, .01371) around (.0005, 0, .00063)."""
    pudding = GROCERIES[0]
    assert pudding.radius_m == pytest.approx(math.hypot(0.0406, 0.02316))
    assert rest_height(pudding.primitives(), pudding.rest_rot) == pytest.approx(0.01371 - 0.00063)
    ketchup = next(item for item in GROCERIES if item.name == "ketchup")
    assert rest_height(ketchup.primitives(), ketchup.rest_rot) == pytest.approx(0.0331 + 0.0393)
    for item in GROCERIES:
        assert sum(geom.mass_kg for geom in item.primitives()) == pytest.approx(item.mass_kg)


def placed(offset, basket_yaw=0.0, **options):
    """The pudding at ``offset`` from the goal's middle along the basket's axes, with the basket turned."""
    state = states(**options)
    basket, turn = state.objects["basket"], from_euler(np.array([[basket_yaw, 0.0, 0.0]]))
    basket.rot[:] = torch.from_numpy(turn)
    where = to_matrix(turn[0]) @ (np.array(CONTAIN_CENTRE_M) + offset)
    state.objects["chocolate_pudding"].pos[:] = basket.pos + torch.from_numpy(where)
    return state


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, 0.7])
@pytest.mark.parametrize(
    ("offset", "solved"),
    [
        ((0.0, 0.0, 0.0), True),
        ((0.0610, 0.0, 0.0), True),
        ((0.0612, 0.0, 0.0), False),
        ((0.0, -0.0610, 0.0), True),
        ((0.0, -0.0612, 0.0), False),
        ((0.0, 0.0, 0.0694), True),
        ((0.0, 0.0, 0.0696), False),
        ((0.0, 0.0, -0.0794), True),  # the box reaches 1 cm lower than its site
        ((0.0, 0.0, -0.0796), False),
    ],
)
def test_success_is_inside_the_basket(offset, solved, yaw):
    assert PickChocolatePudding().success(placed(offset, yaw)).tolist() == [solved]


@pytest.mark.parametrize(
    ("offset", "solved"),
    [
        ((0.079, -0.079, 0.0), True),
        ((0.081, 0.0, 0.0), False),
        ((0.0, -0.081, 0.0), False),
        ((0.0, 0.0, 0.049), True),
        ((0.0, 0.0, 0.051), False),
        ((0.0, 0.0, -0.109), True),
        ((0.0, 0.0, -0.111), False),
    ],
)
def test_the_papers_box_is_larger(offset, solved):
    task = PickChocolatePudding(variant="roboverse")
    assert task.success(placed(offset, variant="roboverse")).tolist() == [solved]


def test_reward_by_hand():
    """Far from the pudding: 0.25 (1 - tanh(5 · 0.1)); let go over the basket: 0.25 (1 + 1 + near) + 0.2."""
    task, state = PickChocolatePudding(), states()
    robot, pudding = state.robots["franka"], state.objects["chocolate_pudding"]
    robot.ee_pos = pudding.pos + torch.tensor([[0.0, 0.0, 0.1]])
    robot.joint_target = robot.joint_pos.clone()
    assert task.reward(state).item() == pytest.approx(0.25 * (1 - np.tanh(0.5)))
    state = placed((0.0, 0.0, 0.08))
    state.robots["franka"].ee_pos = torch.zeros((1, 3), dtype=torch.float64)
    state.robots["franka"].joint_target = state.robots["franka"].joint_pos.clone()
    assert task.reward(state).item() == pytest.approx(0.25 * (2 + 1 - np.tanh(3 * 0.08)) + 0.2)


def test_the_hands_outline_by_hand():
    """Half depth 0.033 along x, half width 0.106 along y; turned by 90° they change places."""
    points = np.array([[0.0, 0.0], [0.053, 0.0], [0.0, 0.126], [0.063, 0.146]])
    assert _distance_to_hand(points, 0.0) == pytest.approx([0.0, 0.02, 0.02, 0.05])
    assert _distance_to_hand(points[1:3, ::-1], math.pi / 2) == pytest.approx([0.02, 0.02])


@pytest.mark.slow
def test_expert_picks_up_a_pudding_on_its_side():
    """It fell on its long edge and is tilted: the fingers then close on its thickness."""
    task = PickChocolatePudding()
    with MujocoHandler(task.scenario, 1) as handler:
        handler.launch()
        state = states()
        pudding = state.objects["chocolate_pudding"]
        pudding.rot[:] = torch.from_numpy(from_euler(np.array([0.5, 0.0, math.pi / 2])))
        pudding.pos[:, 2] = 0.0233
        handler.set_states(state)
        rng = np.random.default_rng(3)
        for target in WaypointPlanner(task.scenario, task.expert).plan(handler.get_states(), rng):
            handler.set_joint_targets({"franka": target[None]})
            handler.step(task.scenario.physics.decimation)
        assert task.success(handler.get_states()).tolist() == [True]


def test_a_basket_that_fell_over_is_given_up():
    state = states()
    state.objects["basket"].rot[:] = torch.from_numpy(from_euler(np.array([0.0, 0.0, 1.5])))
    assert PickChocolatePudding().expert(state, np.random.default_rng(0)) == []


def test_unknown_options_are_errors():
    with pytest.raises(UnknownNameError, match=r"'libro'\. Did you mean 'libero'\? Valid: libero, roboverse"):
        PickChocolatePudding(variant="libro")
    with pytest.raises(UnknownNameError, match=r"starts of PickChocolatePudding 'region'"):
        PickChocolatePudding(starts="region")
    with pytest.raises(ConfigError, match=r"not part of this project\. Give libero_dir=<folder"):
        PickChocolatePudding(starts="libero")


def test_folder_that_is_not_libero_is_an_error(tmp_path):
    with pytest.raises(ConfigError, match=r"has no assets/stable_hope_objects\. Give the folder of a copy"):
        envs.make_vec("PickChocolatePudding", split="train", task_kwargs={"libero_dir": str(tmp_path)})
    (tmp_path / "libero" / "assets" / "stable_hope_objects").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"lacks an object of the scene: no file .*chocolate_pudding\.xml"):
        GROCERIES[0].config(libero_root(str(tmp_path)))
    broken = tmp_path / "libero" / "assets" / "stable_hope_objects" / "chocolate_pudding"
    broken.mkdir()
    (broken / "chocolate_pudding.xml").write_text("<mujoco>")
    with pytest.raises(ConfigError, match=r"chocolate_pudding\.xml cannot be read"):
        GROCERIES[0].config(libero_root(str(tmp_path)))
    (broken / "chocolate_pudding.xml").write_text("<mujoco/>")
    with pytest.raises(ConfigError, match=r"chocolate_pudding\.xml' has no mesh or no texture"):
        GROCERIES[0].config(libero_root(str(tmp_path)))


@pytest.mark.parametrize("content", [b"", b"no pickle", b"\x80\x02X\x03\x00\x00\x00abc.", b"\x80\x02N."])
def test_invalid_initial_states_are_an_error(tmp_path, content):
    path = tmp_path / "a.pruned_init"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", content)
    with pytest.raises(ConfigError, match=r"is not LIBERO's file of initial states|has no initial states"):
        read_init_states(path)
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="is not LIBERO's file of initial states"):
        read_init_states(path)
    with pytest.raises(ConfigError, match=r"no file .*none"):
        read_init_states(tmp_path / "none")


@needs_libero
def test_our_sizes_are_those_of_liberos_boxes():
    libero = libero_root(str(LIBERO))
    for item in GROCERIES:
        ours, theirs = item.config(None), item.config(libero)
        assert ours.pos[2] == pytest.approx(theirs.pos[2], abs=5e-4), item.name
        mass = sum(geom.mass_kg for geom in theirs.geoms)
        assert item.mass_kg == pytest.approx(mass, rel=1e-3), item.name
        assert (theirs.geoms[-1].shape == "mesh") == (item.name != "basket")


@needs_libero
def test_libero_initial_states_are_sampled_and_match_their_description():
    state = states(400, starts="libero", libero_dir=str(LIBERO))
    pudding = state.objects["chocolate_pudding"].pos
    assert torch.allclose(pudding[:, :2], torch.tensor([-0.12, -0.24], dtype=torch.float64))
    assert len(np.unique(state.objects["basket"].pos.numpy(), axis=0)) == 50
    joints = state.robots["franka"].joint_pos
    assert (joints[:, :7] - torch.tensor(HOME[:7])).std() == pytest.approx(0.02, abs=0.002)
    assert torch.allclose(joints[:, 7:], torch.tensor(0.020833, dtype=torch.float64), atol=1e-6)
    for name, (middle, half) in REGIONS.items():
        offset = state.objects[name].pos[:, :2] - torch.tensor(middle)
        assert offset.abs().max() < half + 0.005, name


@needs_libero
def test_the_real_meshes_stand_still_and_are_seen():
    env = envs.make_vec(
        "PickChocolatePudding", 1, split="test", image_size=64, task_kwargs={"libero_dir": str(LIBERO)}
    )
    try:
        env.reset_envs([0], env.split_indices[:1])
        before = env.get_states()
        image = env.observe()["observation.images.front"][0]
        assert image.std() > 10
        hold = before.robots["franka"].joint_pos.numpy()
        for _ in range(40):
            env.step_envs([0], hold)
        for name, entity in env.get_states().objects.items():
            moved = torch.linalg.vector_norm(entity.pos - before.objects[name].pos)
            assert moved < 3e-3, name
    finally:
        env.close()
