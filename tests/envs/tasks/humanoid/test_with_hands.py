"""Stand, walk and run of the H1 with hands against HumanoidBench's own model, where its files are."""

import mujoco
import numpy as np
import pytest
import torch

from envs.core.assets import asset_folder
from envs.core.errors import MissingAssetError
from envs.mjcf.model import build_model
from envs.robots import ROBOTS
from envs.robots.h1_hand import H1_HAND
from envs.simulators import HANDLERS
from envs.simulators.mujoco_warp.settings import WarpSettings
from envs.tasks import TASKS
from tests.envs.tasks.humanoid.published import Published

BARS = {"stand": 800, "walk": 700, "run": 700}
FINGERS = ("FF", "MF", "RF", "LF")


@pytest.fixture(scope="module")
def published():
    try:
        folder = asset_folder("humanoid_bench")
    except MissingAssetError as error:
        pytest.skip(str(error))
    return mujoco.MjModel.from_xml_path(str(folder / "humanoid_bench/assets/envs/h1hand_pos_walk.xml"))


def published_actuator(joint: str) -> str:
    """The name of the published actuator that moves a joint of ours."""
    if not joint.startswith(("lh_", "rh_")):
        return joint
    side, name = joint.split("_")
    bends_two = name[:2] in FINGERS and name.endswith("J2")
    return f"{side}_A_{name[:2]}J0" if bends_two else f"{side}_A_{name}"


def task_of(name):
    return TASKS.get(f"humanoid/h1hand_{name}")()


def test_sizes_and_bars_are_the_published_ones():
    assert ROBOTS.get("h1_hand") is H1_HAND
    assert (len(H1_HAND.joints), len(H1_HAND.driven)) == (69, 61)
    tendons = {joint.name: joint.pulls for joint in H1_HAND.joints if joint.pulls}
    assert tendons == {
        f"{side}_{finger}J2": ((f"{side}_{finger}J1", 1.0),) for side in ("lh", "rh") for finger in FINGERS
    }
    for name, bar in BARS.items():
        task, bare = task_of(name), TASKS.get(f"humanoid/{name}")()
        assert task.success_return == bare.success_return == bar
        assert task.instructions == bare.instructions and task.robot.name == "h1_hand"
        assert len(task.rl_controller.names) == 61
        state = task.initial_state([np.random.default_rng(0)])
        assert task.observe(state).shape == (1, 151)  # 2 · dof - 1, dof = 76
        assert state.robots["h1_hand"].joint_pos.abs().max() > 0.0


def test_without_the_files_a_scene_says_how_to_get_them(tmp_path, monkeypatch):
    monkeypatch.setenv("ROBOVERSE_CACHE", str(tmp_path))
    monkeypatch.setenv("ROBOVERSE_DATA", str(tmp_path))
    with pytest.raises(MissingAssetError, match="Download it with: roboverse assets get humanoid_bench"):
        build_model(task_of("walk").scenario)


@pytest.mark.slow
def test_joints_and_actuators_are_the_published_ones(published):
    model = build_model(task_of("walk").scenario)
    assert (model.nq, model.nv, model.nu) == (published.nq, published.nv, published.nu) == (76, 75, 61)
    assert [published.joint(i).name for i in range(1, published.njnt)] == list(H1_HAND.joint_names)
    np.testing.assert_allclose(model.qpos0[:7], [*H1_HAND.pos, *H1_HAND.rot])
    np.testing.assert_allclose(
        [*H1_HAND.pos, *H1_HAND.rot, *H1_HAND.default_qpos], published.key_qpos[0], atol=1e-12
    )
    for field in ("jnt_range", "jnt_axis", "dof_damping", "dof_armature", "dof_frictionloss"):
        np.testing.assert_allclose(getattr(model, field), getattr(published, field), atol=1e-12)
    bodies = [published.body(i).name for i in range(1, published.nbody)]
    for field in ("mass", "inertia", "ipos", "iquat"):
        ours = [getattr(model.body(f"h1_hand/{name}"), field) for name in bodies]
        np.testing.assert_allclose(ours, [getattr(published.body(name), field) for name in bodies], atol=1e-9)
    for index, joint in enumerate(task_of("walk").rl_controller.names):
        ours, theirs = model.actuator(index), published.actuator(published_actuator(joint))
        for field in ("ctrlrange", "forcerange", "gainprm", "biasprm"):
            np.testing.assert_allclose(getattr(ours, field), getattr(theirs, field), err_msg=joint)


@pytest.fixture(scope="module")
def moved(published):
    """States of 0.8 s of random actions, each beside the published model's, which took the same."""
    task, rng, pairs = task_of("walk"), np.random.default_rng(0), []
    order = [published.actuator(published_actuator(name)).id for name in task.rl_controller.names]
    low, high = published.actuator_ctrlrange[order].T
    data = mujoco.MjData(published)
    with HANDLERS.get("mujoco")(task.scenario, 1, num_threads=1) as handler:
        handler.launch()
        handler.set_states(task.initial_state([np.random.default_rng(0)]))
        data.qpos[:] = qpos_of(handler.get_states())
        for _ in range(40):
            action = rng.uniform(-0.5, 0.5, (1, 61))
            task.controller.apply(handler, action)
            data.ctrl[order] = low + (action[0] + 1.0) / 2.0 * (high - low)
            handler.step(10)
            mujoco.mj_step(published, data, 10)
            state = handler.get_states()
            pairs.append((state, data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()))
    return pairs


def qpos_of(state) -> np.ndarray:
    robot = state.robots["h1_hand"]
    return torch.cat([robot.pos, robot.rot, robot.joint_pos], dim=-1)[0].numpy()


@pytest.mark.slow
def test_it_moves_as_published(moved):
    for state, qpos, qvel, _ in moved:
        seen = task_of("walk").observe(state)[0]
        np.testing.assert_allclose(seen, [*qpos, *qvel], atol=1e-6)
    fingers = np.ptp([qpos[7 + H1_HAND.joint_names.index("lh_FFJ1")] for _, qpos, _, _ in moved])
    assert fingers > 0.1  # the tendon bends it


@pytest.mark.slow
@pytest.mark.parametrize("name", BARS)
def test_rewards_are_those_written_out_by_hand(name, moved, published):
    data, rewards = mujoco.MjData(published), []
    for state, qpos, qvel, ctrl in moved[::4]:
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_forward(published, data)
        rewards.append(task_of(name).reward(state).item())
        assert rewards[-1] == pytest.approx(Published(data).reward(name), abs=1e-6)
    assert max(rewards) > 0.1


@pytest.mark.slow
def test_a_fall_fits_into_the_buffers_of_mujoco_warp(published):
    """Three seconds of targets at their limits, with room for half more."""
    scenario, rng = task_of("walk").scenario, np.random.default_rng(0)
    model, given = build_model(scenario), WarpSettings.of(scenario)
    data, (low, high) = mujoco.MjData(model), model.actuator_ctrlrange.T
    data.qpos[:] = published.key_qpos[0]
    contacts, rows = [], []
    for _ in range(150):
        data.ctrl[:] = np.where(rng.random(61) < 0.5, low, high)
        mujoco.mj_step(model, data, 10)
        contacts.append(data.ncon)
        rows.append(data.nefc)
    assert data.qpos[2] < 0.5
    assert given.nconmax is not None and 4 <= max(contacts) <= given.nconmax / 1.5
    assert given.njmax is not None and max(rows) <= given.njmax / 1.5


@pytest.mark.long
def test_ppo_trains_it(published, tmp_path):
    del published
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.learners import learner_of
    from roboverse_learn.training.metrics import read_metrics
    from roboverse_learn.training.reporter import Reporter

    words = ["policy=ppo", "preset=locomotion", "task=humanoid/h1hand_walk", "simulator=mujoco"]
    words += [
        "policy.num_envs=8",
        "policy.num_steps=16",
        "policy.num_minibatches=2",
        "policy.hidden_dims=[32]",
    ]
    config = compose("train", [*words, "train.steps=1280", "train.log_every=128", "train.num_threads=1"])
    assert learner_of(config, "cpu").learn(tmp_path, None, 0, Reporter()).steps == 1280
    rows = read_metrics(tmp_path)
    assert all(np.isfinite(row["loss"]) for row in rows) and any(row["episodes"] for row in rows)
