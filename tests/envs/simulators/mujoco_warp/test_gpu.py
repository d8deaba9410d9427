"""What only a GPU can get wrong: graphs, streams, and states that are not on the CPU."""

import dataclasses
import gc

import numpy as np
import pytest
import torch
import warp as wp

from envs.experts.actor import expert_episodes
from envs.gym_env import make_vec
from envs.kinematics.batched_inverse import BatchedPathFollower
from envs.kinematics.waypoints import Waypoint
from envs.randomization import Randomizer
from envs.robots.franka import FRANKA
from envs.simulators.mujoco_warp.handler import MujocoWarpHandler
from envs.tasks.pick_cube import PickCube
from tests.envs.simulators.mujoco_warp.conftest import NUM_ENVS, pictures_of, scene, starts
from tests.envs.simulators.mujoco_warp.test_worlds import everything, moving

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="needs an NVIDIA GPU"),
]


def launched(device, count=NUM_ENVS, **settings):
    handler = MujocoWarpHandler(scene(device=device, **settings), count, textures=pictures_of)
    handler.launch()
    return handler


@pytest.fixture(scope="module")
def gpu():
    with launched("cuda") as handler:
        yield handler


def test_states_are_on_the_gpu_and_views_are_its_memory(gpu):
    gpu.set_states(starts())
    states = gpu.get_states()
    assert all(value.is_cuda for value in states.flatten().values())
    gpu.views.qpos[1, 0] = 0.25
    assert gpu.get_states([1]).robots["franka"].joint_pos[0, 0].item() == 0.25


def test_physics_is_that_of_the_cpu(gpu, handler):
    start = moving(starts())
    for simulator in (gpu, handler):
        simulator.set_states(start)
        simulator.step(50)
    assert (everything(gpu).cpu() - everything(handler)).abs().max() < 1e-2
    ours, theirs = (s.get_states().robots["franka"].joint_pos.cpu() for s in (gpu, handler))
    assert (ours - theirs).abs().max() < 1e-4


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


def test_a_graph_of_torch_that_nobody_uses_is_freed_before_a_capture_and_not_amid_it(gpu):
    """As a policy's recorded loss is, whose training is over: freed amid a capture it breaks it."""
    number, unused = torch.zeros(1, device="cuda"), torch.cuda.CUDAGraph()
    with torch.cuda.graph(unused):
        number += 1
    cycle = [unused]
    cycle.append(cycle)
    del unused, cycle
    values = wp.zeros(4, dtype=float, device="cuda:0")
    graph = gpu.on.capture(lambda: (gc.collect(), values.fill_(2.0)))
    with gpu.on.scope():
        graph.launch()
    assert values.numpy().tolist() == [2.0] * 4


def test_others_stand_still_to_the_bit(gpu):
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
    """With contacts mujoco_warp 4.0 does not repeat itself to the bit, whatever it is asked for."""
    with launched("cuda", 64, deterministic=True) as handler:
        ends = []
        for _ in range(2):
            handler.set_states(moving(starts(64)))
            handler.step(100)
            ends.append(everything(handler))
    assert (ends[0] - ends[1]).abs().median() < 1e-5


def test_pictures_are_those_of_the_cpu(gpu, handler):
    """The GPU filters textures with eight bits and rounds fast: three grey levels, one pixel in a hundred."""
    scenario = PickCube().scenario
    randomizer = Randomizer(
        scenario.appearance,
        scenario.cameras,
        channels=("environment", "camera", "lighting"),
        split="train",
        seed=0,
    )
    pictures = []
    for simulator in (gpu, handler):
        simulator.set_states(starts())
        for env_id in range(NUM_ENVS):
            look = randomizer.appearance(int(randomizer.split.episodes[env_id]))
            simulator.set_appearance(look, env_id)
        pictures.append(simulator.render(["front"])["front"]["rgb"].astype(int))
    for env_id in range(NUM_ENVS):
        handler.set_appearance(handler.scenario.appearance, env_id)
    assert (np.abs(pictures[0] - pictures[1]).max(-1) > 3).mean() < 1e-2


def test_a_graph_draws_what_single_launches_draw(gpu):
    """All worlds are drawn by a graph, some of them without one; and a graph draws what is new."""
    gpu.set_states(starts())
    first = gpu.render_tensors(None, ["front"])["front"]["rgb"].clone()
    assert first.is_cuda
    np.testing.assert_array_equal(gpu.render(["front"], env_ids=[2])["front"]["rgb"][0], first[2].cpu())
    gpu.set_states(starts(seed=50))
    second = gpu.render_tensors(None, ["front"])["front"]["rgb"]
    assert not torch.equal(first, second)
    np.testing.assert_array_equal(gpu.render(["front"], env_ids=[1])["front"]["rgb"][0], second[1].cpu())


def test_inverse_kinematics_is_that_of_the_cpu():
    rest = np.array([FRANKA.default_qpos] * 2)
    ways = [
        [Waypoint(pos=np.array([0.5, y, 0.1]), yaw=0.3, gripper=0.04, duration_s=1.0)] for y in (0.1, -0.1)
    ]
    ours, theirs = (
        BatchedPathFollower(FRANKA, 20.0, device).joint_targets(rest, ways).targets.cpu()
        for device in ("cuda", "cpu")
    )
    torch.testing.assert_close(ours, theirs, atol=1e-8, rtol=0)


def test_experts_succeed_in_an_env():
    env = make_vec("PickCube", 8, split="train", simulator="mujoco_warp", image_size=32)
    assert env.handler.device.type == "cuda"
    found = list(expert_episodes(env, env.split_indices[:8].tolist()))
    assert sum(episode.success for episode in found) >= 7
    assert found[0].images["front"].shape[1:] == (32, 32, 3)
    observation, _ = env.reset(seed=0)
    assert isinstance(observation["agent_pos"], np.ndarray)
    _, reward, *_ = env.step(np.tile(np.float32(env.scenario.robots[0].default_qpos), (8, 1)))
    assert reward.shape == (8,)
    env.close()


def test_settings_of_a_scenario_choose_the_device():
    chosen = dataclasses.replace(scene(), simulators={"mujoco_warp": {"device": "cuda:0"}})
    with MujocoWarpHandler(chosen, 1) as handler:
        handler.launch()
        assert handler.device == torch.device("cuda:0")
