"""A task whose scene was changed: its controllers, its expert and its envs know the changed one."""

import contextlib

import numpy as np
import pytest

import envs
from envs.core.errors import UnknownNameError
from envs.experts.actor import expert_episodes
from envs.mjcf.model import build_model
from envs.simulators.mujoco.render import Stage
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.make import make_task

SLOW = {"physics": {"decimation": 50}}


def test_a_task_that_is_not_changed_is_of_its_own_class() -> None:
    assert type(make_task("PickCube", {}, {})) is TASKS.get("PickCube")


def test_a_changed_task_keeps_its_options_and_its_name() -> None:
    task = make_task("PickCube", {"variant": "lift"}, SLOW)
    assert isinstance(task, TASKS.get("PickCube"))
    assert (task.name, getattr(task, "variant", None)) == ("PickCube", "lift")
    assert task.scenario.physics.control_hz == 10.0
    assert make_task("PickCube").scenario.physics.control_hz == 20.0


def test_an_env_steps_at_the_changed_control_rate() -> None:
    elapsed = {}
    for name, scenario in (("usual", None), ("slow", SLOW)):
        env = envs.make_vec("PickCube", observation="state", scenario=scenario)
        with contextlib.closing(env):
            env.reset(seed=0)
            before = env.get_states().robots["franka"].joint_pos.numpy()
            target = before.astype(np.float32) + np.array([0.2] + [0.0] * 8, np.float32)
            env.step(target)
            elapsed[name] = env.get_states().robots["franka"].joint_pos.numpy()[0, 0] - before[0, 0]
            assert env.metadata["render_fps"] == round(env.control_hz) == (10 if scenario else 20)
    assert elapsed["slow"] > 1.2 * elapsed["usual"]  # twice the time to get there


def test_the_expert_solves_the_task_at_another_control_rate() -> None:
    env = envs.make_vec("PickCube", 4, observation="state", split="train", scenario=SLOW)
    with contextlib.closing(env):
        lengths = [outcome for outcome in expert_episodes(env, env.split_indices[:4].tolist())]
    assert sum(outcome.success for outcome in lengths) >= 3
    assert max(len(outcome.actions) for outcome in lengths if outcome.success) <= 50  # of twice the length


def test_another_field_of_view_is_another_image_of_the_same_state() -> None:
    images, states = [], []
    for scenario in (None, {"cameras": {"front": {"fovy_deg": 60}}}):
        env = envs.make_vec("PickCube", split="test", image_size=32, scenario=scenario)
        with contextlib.closing(env):
            env.reset(seed=1)
            images.append(env.observe()["observation.images.front"])
            states.append(env.get_states().robots["franka"].joint_pos.numpy())
    np.testing.assert_array_equal(*states)
    assert (images[0] != images[1]).mean() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("shape", [[1, 1], [3, 4]])
def test_every_lamp_of_the_array_shines(shape: list[int]) -> None:
    scenario = {"lighting": {"array_shape": shape}}
    env = envs.make_vec("PickCube", split="test", only="lighting", image_size=32, scenario=scenario)
    with contextlib.closing(env):
        env.reset(seed=1)
        look = env.randomizer.appearance(int(env.episodes[0]))
        assert len(look.lights) == 1 + shape[0] * shape[1]
        stage = Stage(build_model(env.scenario), env.scenario)
        stage.dress(look)
        assert stage.model.light_active.sum() == len(look.lights)
        assert env.observe()["observation.images.front"].std() > 1  # it is rendered, too


def test_lighting_samples_do_not_depend_on_the_array_shape() -> None:
    drawn = []
    for scenario in (None, {"lighting": {"array_shape": [3, 4]}}):
        env = envs.make_vec("PickCube", split="test", level=3, observation="state", scenario=scenario)
        with contextlib.closing(env):
            env.reset(options={"episodes": env.split_indices[:1]})
            drawn.append(env.draws(0))
    assert drawn[0] == drawn[1]


def test_an_agent_learns_in_the_changed_scene() -> None:
    env = EnvSpec(scenario=SLOW).make_torch(2)
    assert env.handler.scenario.physics.control_hz == 10.0
    env.close()


def test_invalid_scene_change_fails_before_a_simulator_starts() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'decimation'"):
        envs.make_vec("PickCube", scenario={"physics": {"decimatio": 5}})
