"""Parameters of tasks: their limits, what follows them, and that their defaults change nothing."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
import torch

import envs
from envs.core.errors import ConfigError, RoboVerseError, UnknownNameError
from envs.episode_hash import named_values
from envs.experts.actor import expert_episodes
from envs.randomization import channel_rng
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.make import make_task
from envs.tasks.parameters import is_parameter
from envs.tasks.pick_cube import PickCube
from envs.tasks.stack_cube import StackCube

GOLDEN = Path(__file__).with_name("golden_defaults.json")
"""Digests of the scene and of four starts of each task with default parameters, from before there were any.

Written anew by ``python tests/envs/tasks/test_parameters.py`` when a task itself is changed.
"""

NAMES = (
    *("PickCube", "StackCube", "CloseBox", "MoveSliderLeft", "PickChocolatePudding"),
    *("NutAssembly", "NutAssemblySquare", "control/franka_reach", "control/cartpole"),
)


def digests(name: str) -> dict[str, str]:
    """Returns digests of a task's scene and starts, rounded to what every platform computes alike."""
    task = make_task(name)
    starts = task.initial_state([channel_rng(0, "task", episode) for episode in range(4)])
    values = {
        key: (torch.as_tensor(v).double() * 1e9).round().tolist() for key, v in starts.flatten().items()
    }
    return {"scene": digest(named_values(task.scenario)), "starts": digest(values)}


def digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()[:16]


@pytest.mark.parametrize("name", NAMES)
def test_default_parameters_give_the_scene_and_the_starts_of_before(name):
    assert digests(name) == json.loads(GOLDEN.read_text(encoding="utf-8"))[name]


def test_a_spec_without_parameters_keeps_its_hash():
    spec = EnvSpec(task="StackCube", level=2)
    assert spec.hash == "af38eb6742555e20" and EnvSpec().hash == "45f25e945f9e693a"
    assert spec.to_json()["task_kwargs"] == {}


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("PickCube", {"cube_half_size_m": 0.2}, r"at least 0\.008 and at most 0\.036, given 0\.2"),
        ("PickCube", {"cube_half_size_m": "wide"}, r"task_kwargs\.cube_half_size_m: .*given 'wide'"),
        ("PickCube", {"cube_mass_kg": 0}, r"cube_mass_kg of PickCube must be above 0 and at most 2, given 0"),
        ("PickCube", {"qpos_noise_rad": float("nan")}, r"qpos_noise_rad: .*finite number, given nan"),
        (
            "CloseBox",
            {"spawn_x_m": [0.5, 0.4]},
            r"spawn_x_m of CloseBox is an interval.*given \(0\.5",
        ),
        ("CloseBox", {"spawn_x_m": [0.5]}, r"task_kwargs\.spawn_x_m"),
        (
            "StackCube",
            {"spawn_half_size_m": [0.01, 0.01]},
            r"cubes with cube_half_size_m=0\.02 do not fit",
        ),
        ("MoveSliderLeft", {"block_x_m": [0, 0.1]}, "too narrow for three blocks side by side"),
    ],
)
def test_a_value_that_is_not_allowed_is_an_error(name, options, message):
    with pytest.raises(ConfigError, match=message):
        make_task(name, options)


def test_arguments_are_checked_as_keys_are():
    with pytest.raises(ConfigError, match="cube_half_size_m of PickCube must be a number, given True"):
        PickCube(cube_half_size_m=True)
    with pytest.raises(ConfigError, match=r"must be 2 numbers, such as \[0\.1, 0\.2\], given 0\.1"):
        StackCube(spawn_half_size_m=0.1)  # pyright: ignore[reportArgumentType]


def test_an_unknown_parameter_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match=r"'cube_halfsize_m'\. Did you mean 'cube_half_size_m'"):
        make_task("PickCube", {"cube_halfsize_m": 0.03})


@pytest.mark.parametrize("name", NAMES)
def test_every_limit_is_a_task_that_starts(name):
    """Each parameter at its limits, where they are finite, makes a task whose starts are finite."""
    cls = TASKS.get(name)
    for item in dataclasses.fields(cls):
        bounds = item.metadata.get("bounds")
        for value in (bounds.low, bounds.high) if bounds else ():
            given = (value, value) if isinstance(item.default, tuple) else value
            try:
                task = cls(**{item.name: given})
            except RoboVerseError:
                continue  # a limit that is excluded, or two parameters that do not fit together
            flat = task.initial_state([np.random.default_rng(0)]).flatten()
            assert all(torch.as_tensor(part).isfinite().all() for part in flat.values()), item.name


@pytest.mark.parametrize("name", ["PickCube", "StackCube"])
def test_cubes_of_another_size_start_on_the_table(name):
    half = 0.03
    task = make_task(name, {"cube_half_size_m": half})
    start = task.initial_state([np.random.default_rng(0)])
    cubes = [item for item in task.scenario.objects if item.name.startswith("cube")]
    for cube in cubes:
        assert cube.geoms[0].size == (half,) * 3
        assert start.objects[cube.name].pos[0, 2] == half


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("PickCube", {"cube_half_size_m": 0.008}),
        ("PickCube", {"cube_half_size_m": 0.03, "spawn_half_size_m": 0.15}),
        ("StackCube", {"cube_half_size_m": 0.03}),
    ],
)
def test_the_expert_solves_tasks_with_cubes_of_another_size(name, options):
    env = envs.make_vec(name, 4, split="test", observation="state", task_kwargs=options)
    outcomes = [run.success for run in expert_episodes(env, env.split_indices[:4].tolist())]
    env.close()
    assert all(outcomes)


def test_the_success_rule_follows_the_size():
    small, large = PickCube(variant="lift"), PickCube(variant="lift", cube_half_size_m=0.03)
    state = large.initial_state([np.random.default_rng(0)])
    state.objects["cube"].pos[:, 2] = 0.125
    assert small.success(state).item() and not large.success(state).item()


def test_tolerances_decide_success():
    state = StackCube().initial_state([np.random.default_rng(0)])
    a, b = state.objects["cube_a"], state.objects["cube_b"]
    a.pos[:] = b.pos + torch.tensor([0.015, 0.0, 0.04])
    assert StackCube(variant="roboverse").success(state).item()
    assert not StackCube(variant="roboverse", roboverse_tolerance_m=0.01).success(state).item()


def test_every_parameter_is_documented():
    for name in NAMES:
        cls = TASKS.get(name)
        text = "\n".join(base.__doc__ or "" for base in cls.__mro__)
        for item in dataclasses.fields(cls):
            assert f"        {item.name}: " in text or not is_parameter(item), (name, item.name)


if __name__ == "__main__":
    GOLDEN.write_text(json.dumps({name: digests(name) for name in NAMES}, indent=1) + "\n", encoding="utf-8")
