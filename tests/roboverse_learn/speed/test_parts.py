"""Each part of the speed programs, as small as it gets, on a CPU. No ratio is asserted."""

import pytest
import torch

from envs.core.errors import MissingExtraError, SimulatorError
from roboverse_learn.speed import agents, dataset, mujoco_warp, rl, simulators, throughput, training
from roboverse_learn.speed.bare_env import BareEnv
from roboverse_learn.speed.evaluation import measure_evaluation
from roboverse_learn.speed.harness import Measurement
from roboverse_learn.speed.processes import ProcessesSettings
from roboverse_learn.speed.processes import parts as parts_of_processes
from roboverse_learn.speed.startup import first_image, startup
from roboverse_learn.speed.teleoperation import TeleoperationSettings
from roboverse_learn.speed.teleoperation import parts as parts_of_teleoperation
from tests.sweeps import sweep

pytestmark = pytest.mark.slow


def is_measured(found: Measurement, *texts: str) -> bool:
    return (
        found.ours_s > 0 < found.baseline_s and found.ratio > 0 and all(text in found.name for text in texts)
    )


def test_startup_is_measured():
    assert is_measured(startup("list", turns=1), "roboverse list")


def test_a_first_image_is_measured():
    assert is_measured(first_image(turns=1), "first image, 128×128")


def test_teleoperation_is_measured_over_its_websocket():
    measures = parts_of_teleoperation(TeleoperationSettings(view_size=32, seconds=2.0))
    assert is_measured(measures["delay"](), "command to image at 32²")
    assert is_measured(measures["interval"](), "between images")
    assert is_measured(measures["lateness"](), "lateness of a control step")


@pytest.mark.long
def test_training_in_two_processes_is_compared_to_one():
    small = [
        "device=cpu",
        "simulator=mujoco",
        "image_size=32",
        "cameras=[front]",
        "num_demos=2",
        "dim_model=32",
    ]
    small += [
        "dim_feedforward=32",
        "n_encoder_layers=1",
        "chunk_size=8",
        "n_action_steps=4",
        "cuda_graphs=false",
    ]
    settings = ProcessesSettings(first_step=2, steps=2, turns=1, batch_size=4, words=tuple(small))
    measures = parts_of_processes(settings)
    assert list(measures) == ["act", "act_shared", "diffusion", "diffusion_shared"]
    assert is_measured(measures["act"](), "act, 8 samples a step in 2 processes, 4 in one")
    assert is_measured(measures["act_shared"](), "act, 4 samples a step in 2 processes, 4 in one")


@pytest.mark.long
def test_the_error_of_a_training_is_in_the_message():
    settings = ProcessesSettings(turns=1, words=("device=cpu", "dataset=nowhere"))
    with pytest.raises(SimulatorError, match=r"The training measure-act-in-2-of-256 failed: .*nowhere"):
        parts_of_processes(settings)["act"]()


def test_evaluation_runs_the_episodes_of_lerobot_eval():
    assert is_measured(
        measure_evaluation(num_episodes=1, turns=1), "evaluation of ACT, 64×64, LeRobot / ours"
    )


@pytest.mark.parametrize("visuals", [True, False])
def test_env_step_is_compared_on_the_same_physics(visuals):
    assert is_measured(throughput.measure_step("PickCube", 1, num_steps=10, visuals=visuals), "mj_step loop")


def test_render_needs_osmesa(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(SimulatorError, match="MUJOCO_GL is not 'osmesa'"):
        throughput.measure_render("PickCube", 1)
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with pytest.raises(SimulatorError, match=r"libOSMesa is not installed.*apt-get install libosmesa6"):
        throughput.measure_render("PickCube", 1)


@pytest.mark.parametrize("name", simulators.SCRIPTS)
def test_handler_ends_where_the_script_ends(name):
    try:
        found = simulators.measure_overhead(name, turns=1, control_steps=3)
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert is_measured(found, f"{name}: control step")


def test_other_physics_is_not_compared(monkeypatch):
    def script(handler, robot):
        step, joints = simulators.mujoco_script(handler, robot)
        return lambda target, count: step(target + 0.1, count), joints

    monkeypatch.setitem(simulators.SCRIPTS, "mujoco", script)
    with pytest.raises(SimulatorError, match="this is not the same physics"):
        simulators.measure_overhead("mujoco", turns=1, control_steps=3)


WARP = mujoco_warp.Scale(physics_envs=2, control_steps=1, render_envs=2, images=1, turns=1)


def test_warp_physics_ends_where_bare_physics_ends():
    assert is_measured(mujoco_warp.measure_physics(WARP, "cpu"), "2 envs on cpu, bare mujoco_warp / ours")


@pytest.mark.parametrize(("simplified", "goal"), [(True, 0.9), (False, 2.0)])
def test_warp_images_are_compared(simplified, goal):
    found = mujoco_warp.measure_render(WARP, 16, "cpu", simplified=simplified)
    assert is_measured(found, "RGB 16×16, 2 envs on cpu") and found.goal.limit == goal


AGENTS = agents.Scale(
    model_size=1, sequences=2, plan_envs=1, fasttd3_steps=8, fasttd3_dim=16, updates=1, turns=1
)


@pytest.mark.parametrize(
    "part", sweep(["tdmpc2_update", "tdmpc2_planning", "fasttd3_update"], {"fasttd3_update"})
)
def test_agents_are_compared_with_plain_torch(part):
    assert is_measured(
        agents.measurements(AGENTS, "cpu", compiled=False)[part](), "on cpu, plain torch / ours"
    )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")  # of the compiler
@pytest.mark.parametrize("part", ["tdmpc2_update", "fasttd3_update"])
def test_agents_are_compiled_on_a_cpu_too(part):
    assert is_measured(agents.measurements(AGENTS, "cpu", compiled=True)[part]())


def test_replay_batches_have_one_size_and_are_of_one_episode(monkeypatch):
    pytest.importorskip("torchrl")
    monkeypatch.setattr(agents, "STEPS", 4000)
    ours, theirs = (make(3, 2, "cpu")() for make in (agents.our_sequences, agents.torchrl_slices))
    assert ours.actions.numel() == theirs["action"].numel() == 256 * 4 * 2
    episodes = theirs["episode"].view(256, 4)
    assert (episodes == episodes[:, :1]).all()
    assert is_measured(agents.measure_replay(AGENTS, "cpu"), "replay, 256 sequences of 4 on cpu")


def test_missing_torchrl_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torchrl.data", None)
    with pytest.raises(MissingExtraError, match=r"parts=\[replay\] compares .*roboverse-learn\[torchrl\]"):
        agents.torchrl_slices(3, 2, "cpu")


def test_bare_env_looks_like_ours_and_restarts():
    ours, bare = rl.make_env(2, "cpu"), BareEnv(2, "cpu")
    names = ("num_envs", "observation_size", "action_size", "max_episode_steps")
    assert all(getattr(ours, name) == getattr(bare, name) for name in names)
    assert ours.step(torch.zeros(2, 5)).obs.shape == bare.step(torch.zeros(2, 5)).obs.shape == (2, 47)
    ours.close()
    first = bare.reset().clone()
    assert not torch.equal(bare.step(torch.ones(2, 5)).obs[:, :9], first[:, :9])
    bare.elapsed_steps[0] = bare.max_episode_steps - 1
    step = bare.step(torch.ones(2, 5))
    assert step.truncated.tolist() == [True, False] and not step.terminated.any()
    torch.testing.assert_close(step.obs[0, :16], first[0, :16])
    assert not torch.equal(step.final_obs[0, :16], step.obs[0, :16])


@pytest.mark.long
def test_steps_of_ppo_are_compared():
    pytest.importorskip("rsl_rl")
    config = rl.PpoConfig(num_envs=2, num_steps=2, num_minibatches=1, num_epochs=1, hidden_dims=(8,))
    assert is_measured(rl.measure_throughput(config, "cpu", 1, 1), "2 envs on cpu, bare mujoco_warp / ours")


@pytest.mark.parametrize(
    ("name", "module"), [("rsl_rl", "rsl_rl"), ("sb3", "stable_baselines3"), ("torchrl", "torchrl")]
)
def test_adapter_contains_the_step_of_the_env(name, module):
    pytest.importorskip(module)
    found = rl.measure_adapter(name, 2, "cpu", num_steps=1)
    assert is_measured(found, name) and found.ratio > 0.99


TRAINING = training.Scale(batch_size=2, image_size=32, num_frames=8, steps=1, turns=1, compared=2)


def test_batch_of_a_step_is_fixed():
    frames = training.Frames(TRAINING, {"action": [0, 1, 2]}, "cpu")
    first, again, other = frames.batch(3), frames.batch(3), frames.batch(4)
    assert first["action"].shape == (2, 3, 9) and first["action_is_pad"].shape == (2, 3)
    assert all(first[key].equal(again[key]) for key in first)
    assert not first["observation.state"].equal(other["observation.state"])


@pytest.mark.long
@pytest.mark.parametrize("name", ["act", "diffusion"])
def test_both_sides_of_training_have_the_same_loss(name):
    found = training.measure(name, TRAINING, "cpu", training.Compilation(enabled=False))
    assert is_measured(found, f"training step of {name}, batch 2, 32×32, bf16 on cpu")


@pytest.mark.slow
@pytest.mark.parametrize("part", ["write", "write_streaming", "read", "read_busy"])
def test_dataset_is_compared(part, monkeypatch):
    monkeypatch.setattr("logging.disable", lambda level: None)
    tiny = dataset.DatasetSettings(episodes=1, length=8, size=64, batch_size=2, batches=1)
    assert is_measured(dataset.parts(tiny)[part]())
