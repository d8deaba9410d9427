"""NutAssembly against robosuite's own environment: success, reward, initial states and geometry."""

import importlib
import warnings

import mujoco
import numpy as np
import pytest
import torch

from envs.compat.mujoco4 import repair_robosuite
from envs.mjcf.model import build_model
from envs.tasks.nut_assembly import NutAssembly, NutAssemblySquare
from tests.sweeps import sweep

TASKS = {"NutAssembly": NutAssembly(), "NutAssemblySquare": NutAssemblySquare()}
TABLE_Z = 0.82


@pytest.fixture(scope="module", params=sweep(TASKS, {"NutAssembly"}))
def pair(request):
    """Our task and robosuite's environment of that name, without a renderer."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # robosuite's escapes and absent optional parts
        suite = importlib.import_module("robosuite")
        repair_robosuite()
        theirs = suite.make(
            request.param,
            robots="Panda",
            has_renderer=False,
            has_offscreen_renderer=False,
            use_camera_obs=False,
        )
        theirs.reset()
    yield TASKS[request.param], theirs
    theirs.close()


def put(theirs, poses, hand):
    """Puts robosuite's nuts and the end effector, where its checks read them."""
    for name, pos in poses.items():
        theirs.sim.data.body_xpos[theirs.obj_body_id[name]] = pos
    theirs.sim.data.site_xpos[theirs.robots[0].eef_site_id["right"]] = hand


def same(task, poses, hand):
    """Our state of the same."""
    state = task.initial_state([np.random.default_rng(0)])
    ours = {"SquareNut": "square_nut", "RoundNut": "round_nut"}
    for name, pos in poses.items():
        if ours[name] in state.objects:
            state.objects[ours[name]].pos = torch.from_numpy(pos[None] - [0.0, 0.0, TABLE_Z])
    robot = state.robots["franka"]
    robot.ee_pos = torch.from_numpy(hand[None] - [0.0, 0.0, TABLE_Z])
    robot.joint_target = robot.joint_pos.clone()
    return state


def draw(rng, theirs):
    """Nuts near the edges of what counts as on their pegs, the hand near one of them.

    Where robosuite plays with one nut, it moves the other one out of the scene.
    """
    poses = {
        name: np.array([0.23, y, TABLE_Z + 0.03]) + rng.uniform(-1.0, 1.0, 3) * [0.034, 0.034, 0.025]
        for name, y in (("SquareNut", 0.1), ("RoundNut", -0.1))
    }
    near = poses[str(rng.choice(list(poses)))]
    if theirs.single_object_mode:
        poses["RoundNut"] = np.array([10.0, 10.0, 10.0])
    return poses, near + rng.normal(0.0, 1.0, 3) * rng.choice([0.03, 0.1])


@pytest.mark.slow
def test_success_is_robosuites(pair):
    task, theirs = pair
    rng = np.random.default_rng(0)
    expected, given = [], []
    for _ in range(2000):
        poses, hand = draw(rng, theirs)
        put(theirs, poses, hand)
        expected.append(bool(theirs._check_success()))
        given.append(bool(task.success(same(task, poses, hand))))
    assert given == expected
    assert 0.1 < np.mean(expected) < 0.9


@pytest.mark.slow
def test_reward_without_a_grasp_is_robosuites(pair):
    """Reach and hover; a grasp needs contacts, which these poses have none of."""
    task, theirs = pair
    rng = np.random.default_rng(1)
    nuts = 2 if theirs.single_object_mode == 0 else 1
    for _ in range(200):
        poses, hand = draw(rng, theirs)
        # Handles are where the simulator has them: at the nuts' own orientation, unturned.
        put(theirs, poses, hand)
        for nut, along in zip(theirs.nuts, (0.054, 0.06), strict=True):
            site = theirs.sim.model.site_name2id(nut.important_sites["handle"])
            theirs.sim.data.site_xpos[site] = poses[nut.name] + np.array([along, 0.0, 0.0])
        if theirs._check_success():
            continue
        on_pegs = theirs.objects_on_pegs[:nuts]
        reach = hover = 0.0
        for i, (nut, y, along) in enumerate(
            zip(theirs.nuts[:nuts], (0.1, -0.1), (0.054, 0.06), strict=False)
        ):
            if not on_pegs[i]:
                pos = poses[nut.name]
                handle = np.linalg.norm(pos + np.array([along, 0.0, 0.0]) - hand)
                reach = max(reach, 0.1 * (1 - np.tanh(10 * handle)))
                hover = max(hover, 0.2 * (1 - np.tanh(10 * np.linalg.norm(pos[:2] - [0.23, y]))))
        state = same(task, poses, hand)
        for name in ("square_nut", "round_nut"):
            if name in state.objects:
                state.objects[name].rot = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
        assert task.reward(state).item() == pytest.approx((on_pegs.sum() + max(reach, hover)) / nuts)


def test_initial_states_have_robosuites_ranges(pair):
    task, theirs = pair
    ours = task.initial_state([np.random.default_rng(i) for i in range(1000)])
    placements = [theirs.placement_initializer.sample() for _ in range(1000)]
    for name, object_name in (("SquareNut", "square_nut"), ("RoundNut", "round_nut")):
        if object_name not in ours.objects:
            continue
        expected = np.array([p[name][0] for p in placements])
        given = ours.objects[object_name].pos.numpy()
        for axis in (0, 1):
            spread = np.ptp(expected[:, axis])
            for statistic in (np.min, np.max):
                close = pytest.approx(statistic(expected[:, axis]), abs=0.02 * spread)
                assert statistic(given[:, axis]) == close
            assert given[:, axis].mean() == pytest.approx(expected[:, axis].mean(), abs=0.06 * spread)
        turns = np.array([2 * np.arctan2(p[name][1][3], p[name][1][0]) for p in placements])
        rot = ours.objects[object_name].rot.numpy()
        ours_turns = 2 * np.arctan2(rot[:, 3], rot[:, 0])
        for quarter in range(4):  # any heading is as likely
            low = quarter * np.pi / 2
            for headings in (turns, ours_turns):
                inside = (headings % (2 * np.pi) >= low) & (headings % (2 * np.pi) < low + np.pi / 2)
                assert inside.mean() == pytest.approx(0.25, abs=0.06)


def test_geometry_is_robosuites(pair):
    """Pegs, robot base, table, rest posture, and the nuts' masses."""
    task, theirs = pair
    model, data = theirs.sim.model, theirs.sim.data
    ours = build_model(task.scenario, simplify=False)
    home = mujoco.MjData(ours)
    mujoco.mj_kinematics(ours, home)
    down = np.array([0.0, 0.0, TABLE_Z])
    for nut, their_nut, peg in zip(task.nuts, theirs.nuts, ("peg1", "peg2"), strict=False):
        np.testing.assert_allclose(nut.peg_pos, data.body_xpos[model.body_name2id(peg)] - down, atol=1e-12)
        mass = ours.body(nut.name).subtreemass[0]
        assert mass == pytest.approx(model.body_mass[theirs.obj_body_id[their_nut.name]])
        first = int(ours.body(f"{nut.name}/object").geomadr[0])
        for offset, geom in enumerate(their_nut.contact_geoms):
            index = model.geom_name2id(geom)
            for field in ("geom_pos", "geom_quat", "geom_size", "geom_friction"):
                expected = getattr(model._model, field)[index]
                np.testing.assert_allclose(getattr(ours, field)[first + offset], expected, atol=1e-7)
        geoms = [
            g for g in range(model._model.ngeom) if model._model.geom_bodyid[g] == model.body_name2id(peg)
        ]
        size = model._model.geom_size[geoms[0]][: len(nut.peg_geom.size)]
        np.testing.assert_allclose(nut.peg_geom.size, size)
    base = data.body_xpos[model.body_name2id("robot0_base")] - down
    np.testing.assert_allclose(home.body("franka/base").xpos, base, atol=1e-12)
    np.testing.assert_allclose(task.scenario.robots[0].default_qpos[:7], theirs.robots[0].init_qpos)
    assert task.scenario.table.half_size == (theirs.table_full_size[0] / 2, theirs.table_full_size[1] / 2)
