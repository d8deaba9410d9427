"""Physics on a GPU: graphs, streams, states that are not on the CPU, and the same numbers as on a CPU."""

import dataclasses
import gc
import time
from contextlib import closing

import numpy as np
import pytest
import torch
import warp as wp

import envs
from envs.experts.actor import expert_episodes
from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.waypoints import Waypoint
from envs.robots.franka import FRANKA
from envs.simulators import HANDLERS
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, scene, starts
from tests.envs.simulators.mujoco_warp.test_worlds import everything, moving

pytestmark = pytest.mark.gpu

POSITIONS = ("pos", "joint_pos", "ee_pos")


def launched(count=NUM_ENVS, **settings):
    handler = HANDLERS.get("mujoco_warp")(scene(device="cuda", **settings), count)
    handler.launch()
    return handler


@pytest.fixture(scope="module")
def gpu():
    with launched() as handler:
        yield handler


def test_states_are_on_the_gpu_and_views_are_its_memory(gpu):
    gpu.set_states(starts())
    states = gpu.get_states()
    assert all(value.is_cuda for value in states.flatten().values())
    gpu.views.qpos[1, 0] = 0.25
    assert gpu.get_states([1]).robots["franka"].joint_pos[0, 0].item() == 0.25


def test_physics_is_that_of_the_cpu(gpu):
    """Of MuJoCo in float64, after 0.1 s in which the cube lands and the arm moves."""
    found = {}
    with HANDLERS.get("mujoco")(scene(), NUM_ENVS, num_threads=1) as cpu:
        cpu.launch()
        for name, simulator in (("gpu", gpu), ("cpu", cpu)):
            simulator.set_states(moving(starts()))
            simulator.step(50)
            found[name] = simulator.get_states().flatten()
    assert found["gpu"].keys() == found["cpu"].keys()
    for key, expected in found["cpu"].items():
        error = (found["gpu"][key].cpu() - expected).abs().amax().item() if expected.numel() else 0.0
        assert error < (1e-4 if key.rpartition("/")[2] in POSITIONS else 1e-2), key


def test_an_env_observes_and_rewards_as_on_the_cpu():
    rest = np.array(FRANKA.default_qpos, np.float32)
    found = []
    for simulator in ("mujoco_warp", "mujoco"):
        with closing(envs.make_vec("PickCube", 4, observation="state", simulator=simulator)) as env:
            ids = np.arange(4)
            env.reset_envs(ids, env.split_indices[:4])
            results = [env.step_envs(ids, np.tile(rest + 0.01 * step, (4, 1))) for step in range(10)]
            rewards = np.stack([result.reward for result in results])
            numbers = [values for key, values in env.observe().items() if key != "task"]
            found.append((rewards, *numbers, env.handler.device.type))
    (*gpu, gpu_device), (*cpu, cpu_device) = found
    assert (gpu_device, cpu_device) == ("cuda", "cpu")
    for ours, theirs in zip(gpu, cpu, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-3, rtol=0)


def test_it_works_in_any_stream_of_torch(gpu):
    gpu.set_states(moving(starts()))
    gpu.step(10)
    expected = gpu.get_states().robots["franka"].joint_pos.clone()
    stream = torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        gpu.set_states(moving(starts()))
        gpu.step(10)
        found = gpu.get_states().robots["franka"].joint_pos.clone()
    torch.cuda.current_stream().wait_stream(stream)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=0)


def test_unused_torch_graph_is_not_freed_amid_a_capture(gpu):
    """As a policy's recorded loss could be after its training: it would break the capture."""
    number, unused = torch.zeros(1, device="cuda"), torch.cuda.CUDAGraph()
    with torch.cuda.graph(unused):
        number += 1
    cycle = [unused]
    cycle.append(cycle)
    del unused, cycle
    values = wp.zeros(4, dtype=float, device="cuda:0")

    def launches():
        assert not gc.isenabled()
        more = [[] for _ in range(3 * gc.get_threshold()[0])]  # would start the collector
        values.fill_(2.0)
        del more

    graph = gpu.on.capture(launches)
    assert gc.isenabled()
    with gpu.on.scope():
        graph.launch()
    assert values.numpy().tolist() == [2.0] * 4


def test_collector_is_on_after_a_capture_that_fails(gpu):
    with pytest.raises(RuntimeError, match="no launch"):
        gpu.on.capture(fail)
    assert gc.isenabled()


def fail():
    raise RuntimeError("no launch")


def test_other_environments_stay_bit_identical(gpu):
    gpu.set_states(moving(starts()))
    before = everything(gpu)
    gpu.step(5, [0])
    after = everything(gpu)
    assert torch.equal(after[1:], before[1:])
    assert not torch.equal(after[0], before[0])


def test_a_lost_world_is_counted_alone(gpu):
    gpu.set_states(moving(starts()))
    counted = gpu.num_resets.clone()
    gpu.views.qvel[1, 3] = torch.nan
    gpu.step(10)
    assert (gpu.num_resets - counted).tolist() == [0, 1, 0, 0]
    assert torch.isfinite(everything(gpu)).all()


def test_deterministic_physics_repeats_itself_to_rounding():
    """With contacts mujoco_warp 4.0 is never bit-identical between runs, whatever its settings."""
    with launched(64, deterministic=True) as handler:
        ends = []
        for _ in range(2):
            handler.set_states(moving(starts(64)))
            handler.step(100)
            ends.append(everything(handler))
    assert (ends[0] - ends[1]).abs().median() < 1e-5


def test_inverse_kinematics_is_that_of_the_cpu():
    rest = np.array([FRANKA.default_qpos] * 2)
    ways = [
        [Waypoint(pos=np.array([0.5, y, 0.1]), yaw=0.3, gripper=0.04, duration_s=1.0)] for y in (0.1, -0.1)
    ]
    followers = [BatchedPathFollower(FRANKA, 20.0, device) for device in ("cuda", "cpu")]
    assert followers[0]._kernel is not None
    ours, theirs = (follower.joint_targets(rest, ways).targets.cpu() for follower in followers)
    torch.testing.assert_close(ours, theirs, atol=1e-8, rtol=0)
    torch.cuda.synchronize()


def test_many_paths_take_little_longer_than_one():
    """A path is a thread: in torch a plan of 100 steps takes 200 ms and more."""
    follower = BatchedPathFollower(FRANKA, 20.0, "cuda")
    way = [Waypoint(pos=np.array([0.5, 0.1, 0.1]), yaw=0.3, gripper=0.04, duration_s=5.0)]
    rest = follower._tensor(np.array([FRANKA.default_qpos] * 512))[:, follower._chain.columns]
    pos = follower._tensor(np.tile(way[0].pos, (512, 100, 1)))
    rot = follower._ik.upright.expand(512, 100, 3, 3)
    follower._follow(rest, pos, rot)
    torch.cuda.synchronize()
    started = time.perf_counter()
    follower._follow(rest, pos, rot)
    torch.cuda.synchronize()
    assert time.perf_counter() - started < 0.3


def test_experts_succeed_in_an_env():
    with closing(envs.make_vec("PickCube", 8, simulator="mujoco_warp", image_size=32)) as env:
        assert env.handler.device.type == "cuda"
        found = list(expert_episodes(env, env.split_indices[:8].tolist()))
        assert sum(episode.success for episode in found) >= 7
        assert found[0].images["front"].shape[1:] == (32, 32, 3)
        observation, _ = env.reset(seed=0)
        assert isinstance(observation["agent_pos"], np.ndarray)
        _, reward, *_ = env.step(np.tile(np.float32(env.scenario.robots[0].default_qpos), (8, 1)))
        assert reward.shape == (8,)


def test_settings_of_a_scenario_choose_the_device():
    chosen = dataclasses.replace(scene(), simulators={"mujoco_warp": {"device": "cuda:0"}})
    with HANDLERS.get("mujoco_warp")(chosen, 1) as handler:
        handler.launch()
        assert handler.device == torch.device("cuda:0")
