"""Each part of the speed programs, as small as it gets, on a CPU. No ratio is asserted."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
import torch

from envs.core.errors import MissingExtraError, SimulatorError
from envs.core.extras import install_command
from roboverse_learn.speed import agents, simulators
from roboverse_learn.speed.agents import Agents
from roboverse_learn.speed.bare_env import BareEnv
from roboverse_learn.speed.dataset import Dataset
from roboverse_learn.speed.evaluation import Evaluation
from roboverse_learn.speed.harness import Measurement, Program
from roboverse_learn.speed.mujoco_warp import MujocoWarp
from roboverse_learn.speed.processes import Processes
from roboverse_learn.speed.rl import Rl
from roboverse_learn.speed.simulators import Simulators
from roboverse_learn.speed.startup import Startup
from roboverse_learn.speed.teleoperation import Teleoperation
from roboverse_learn.speed.throughput import Throughput
from roboverse_learn.speed.training import Training

pytestmark = pytest.mark.slow


SMALL = dict(device="cpu", turns=1)
WARP = MujocoWarp(**SMALL, physics_envs=2, control_steps=1, render_envs=2, images=1)
RL = Rl(**SMALL, num_envs=2, rollouts=1, steps=1)
TRAINING = Training(**SMALL, batch_size=2, image_size=32, num_frames=8, steps=1, compared=2)
AGENTS = Agents(**SMALL, model_size=1, sequences=2, plan_envs=1, fasttd3_steps=8, fasttd3_dim=16, updates=1)


def rows(program: Program, texts: dict[str, str], *marks: pytest.MarkDecorator) -> list:
    """Returns parameters: a program, a part of it, and what its row says."""
    name = type(program).__name__
    return [
        pytest.param(program, part, text, marks=marks, id=f"{name}-{part}") for part, text in texts.items()
    ]


def is_measured(found: Measurement, text: str = "") -> bool:
    return found.ours_s > 0 < found.baseline_s and found.ratio > 0 and text in found.name


@pytest.mark.parametrize(
    ("program", "part", "text"),
    [
        *rows(Startup(), {"list": "roboverse list", "first_image": "first image, 128×128"}),
        *rows(Evaluation(num_episodes=1, turns=1), {"act": "evaluation of ACT, 64×64, LeRobot / ours"}),
        *rows(Throughput(turns=1), {"step": "mj_step loop", "step_without_visuals": "without visuals"}),
        *rows(Simulators(turns=1), {name: f"{name}: control step" for name in simulators.SCRIPTS}),
        *rows(WARP, {"physics": "2 envs on cpu, bare mujoco_warp / ours"}),
        *rows(AGENTS, {"fasttd3_update": "FastTD3, update, batch 8 on cpu, plain torch / ours"}),
        *rows(AGENTS, {"tdmpc2_update": "on cpu", "tdmpc2_planning": "for 1 envs"}, pytest.mark.long),
        *rows(TRAINING, {"act": "step of act, batch 2, 32×32, bf16 on cpu"}, pytest.mark.long),
        *rows(TRAINING, {"diffusion": "step of diffusion, batch 2, 32×32"}, pytest.mark.long),
        *rows(
            Dataset(episodes=1, length=8, size=64, batch_size=2, batches=1),
            {"write": "(defaults)", "write_streaming": "(streaming)", "read": "of 2", "read_busy": "busy"},
        ),
        *rows(
            Teleoperation(view_size=32, seconds=2.0),
            {
                "delay": "image at 32²",
                "interval": "between images",
                "lateness": "lateness of a control step",
                "latest": "lateness of the latest control step",
            },
        ),
    ],
)
def test_a_part_is_measured(program, part, text, monkeypatch):
    monkeypatch.setattr("logging.disable", lambda level: None)
    monkeypatch.setattr("roboverse_learn.speed.startup.TURNS", 1)
    try:
        found = program.measurements()[part]()
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert is_measured(found, text)


@pytest.mark.long
def test_training_in_two_processes_is_compared_to_one():
    small = (
        "device=cpu simulator=mujoco image_size=32 cameras=[front] num_demos=2 dim_model=32 "
        "dim_feedforward=32 n_encoder_layers=1 chunk_size=8 n_action_steps=4 cuda_graphs=false"
    )
    tiny = Processes(first_step=2, steps=2, turns=1, batch_size=4, words=tuple(small.split()))
    measures = tiny.measurements()
    assert list(measures) == ["act", "act_shared", "diffusion", "diffusion_shared"]
    assert is_measured(measures["act"](), "act, 8 samples a step in 2 processes, 4 in one")
    assert is_measured(measures["act_shared"](), "act, 4 samples a step in 2 processes, 4 in one")


@pytest.mark.long
def test_the_error_of_a_training_is_in_the_message():
    settings = Processes(turns=1, words=("device=cpu", "dataset=nowhere"))
    with pytest.raises(SimulatorError, match=r"The training measure-act-in-2-of-256 failed: .*nowhere"):
        settings.measurements()["act"]()


def test_render_needs_osmesa(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(SimulatorError, match="MUJOCO_GL is not 'osmesa'"):
        Throughput(turns=1).render()
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    monkeypatch.setattr("ctypes.util.find_library", lambda name: None)
    with pytest.raises(SimulatorError, match=r"libOSMesa is not installed.*apt-get install libosmesa6"):
        Throughput(turns=1).render()


def test_other_physics_is_not_compared(monkeypatch):
    def script(handler, robot):
        step, joints = simulators.mujoco_script(handler, robot)
        return lambda target, count: step(target + 0.1, count), joints

    monkeypatch.setitem(simulators.SCRIPTS, "mujoco", script)
    with pytest.raises(SimulatorError, match="this is not the same physics"):
        Simulators(turns=1).overhead("mujoco", control_steps=3)


@pytest.mark.parametrize(("simplified", "goal"), [(True, 0.9), (False, 2.0)])
def test_warp_images_are_compared(simplified, goal):
    found = WARP.render(16, simplified=simplified)
    assert is_measured(found, "RGB 16×16, 2 envs on cpu") and found.goal.limit == goal


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")  # of the compiler
@pytest.mark.parametrize("part", ["tdmpc2_update", "fasttd3_update"])
def test_agents_are_compiled_on_a_cpu_too(part):
    assert is_measured(replace(AGENTS, compile=True).measurements()[part]())


def test_replay_batches_have_one_size_and_are_of_one_episode(monkeypatch):
    pytest.importorskip("torchrl")
    monkeypatch.setattr(agents, "STEPS", 4000)
    ours, theirs = (make(3, 2, "cpu")() for make in (agents.our_sequences, agents.torchrl_slices))
    assert ours.actions.numel() == theirs["action"].numel() == 256 * 4 * 2
    episodes = theirs["episode"].view(256, 4)
    assert (episodes == episodes[:, :1]).all()
    assert is_measured(AGENTS.replay(), "replay, 256 sequences of 4 on cpu")


def test_missing_torchrl_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "torchrl.data", None)
    needed = rf"parts=\[replay\] compares .*{re.escape(install_command('torchrl'))}"
    with pytest.raises(MissingExtraError, match=needed):
        agents.torchrl_slices(3, 2, "cpu")


def test_bare_env_looks_like_ours_and_restarts():
    ours, bare = RL.make_env(), BareEnv(2, "cpu")
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
    assert is_measured(RL.throughput(), "2 envs on cpu, bare mujoco_warp / ours")


@pytest.mark.parametrize(
    ("name", "module"), [("rsl_rl", "rsl_rl"), ("sb3", "stable_baselines3"), ("torchrl", "torchrl")]
)
def test_adapter_contains_the_step_of_the_env(name, module):
    pytest.importorskip(module)
    found = RL.adapter(name)
    assert is_measured(found, name) and found.ratio > 0.99


def test_batch_of_a_step_is_fixed():
    batch = TRAINING.batches(SimpleNamespace(delta_indices={"action": [0, 1, 2]}, device="cpu"))
    first, again, other = batch(3), batch(3), batch(4)
    assert first["action"].shape == (2, 3, 9) and first["action_is_pad"].shape == (2, 3)
    assert all(first[key].equal(again[key]) for key in first)
    assert not first["observation.state"].equal(other["observation.state"])
