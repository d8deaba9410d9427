"""A change of a scene that the task's start replaces is refused, with the parameter to use instead."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.spec import EnvSpec
from envs.tasks import TASKS
from envs.tasks.make import make_task
from envs.tasks.pick_cube import PickCube
from roboverse_learn.config.scenario_overrides import checked_scenario


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "PickCube",
            {"objects": {"cube": {"pos": [0.1, 0.0, 0.02]}}},
            r"scenario\.objects\.cube\.pos cannot be changed for PickCube: its start sets the position of "
            r"'cube' in every episode\. Give task_kwargs\.cube_half_size_m=… or "
            r"task_kwargs\.spawn_half_size_m=… instead",
        ),
        (
            "PickCube",
            {"objects": {"goal": {"pos": [0.1, 0.0, 0.02]}}},
            r"task_kwargs\.goal_height_m=…",
        ),
        (
            "PickCube",
            {"objects": {"cube": {"rot": [0.0, 0.0, 0.0, 1.0]}}},
            r"the orientation of 'cube'.*has no parameter for it",
        ),
        (
            "PickCube",
            {"objects": {"cube": {"geoms": {"0": {"size": [0.03, 0.03, 0.03]}}}}},
            r"geoms\.0\.size cannot be changed.*task_kwargs\.cube_half_size_m=…",
        ),
        (
            "CloseBox",
            {"objects": {"box_base": {"links": {"box_joint": {"joint": {"default": 1.0}}}}}},
            r"default cannot be changed for CloseBox: its start sets the joints of 'box_base'",
        ),
        (
            "NutAssembly",
            {"objects": {"square_nut": {"pos": [0.0, 0.2, 0.01]}}},
            r"task_kwargs\.spawn_x_m=… or task_kwargs\.spawn_y_m=…",
        ),
    ],
)
def test_what_the_start_replaces_is_refused(name, changes, message):
    for make in (make_task, checked_scenario):
        arguments = (name, {}, changes)
        with pytest.raises(ConfigError, match=message):
            make(*arguments)
    with pytest.raises(ConfigError, match=message):
        EnvSpec(task=name, scenario=changes).make_task()


@pytest.mark.parametrize(
    "changes",
    [
        {"objects": {"cube": {"geoms": {"0": {"mass_kg": 0.1, "rgba": [0.0, 0.0, 1.0, 1.0]}}}}},
        {"robots": {"franka": {"pos": [-0.6, 0.0, 0.0]}}},
        {"cameras": {"front": {"pos": [1.0, 0.0, 0.7]}}},
        {"physics": {"decimation": 50}},
        {"objects": {"cube": {"pos": [0.0, 0.0, 0.02]}}},  # what it is
    ],
)
def test_what_the_start_keeps_may_be_changed(changes):
    make_task("PickCube", {}, changes)


def test_the_start_follows_the_rest_posture_of_the_scene():
    changes = {"robots": {"franka": {"joints": {"joint1": {"default": 0.4}}}}}
    task = make_task("PickCube", {"qpos_noise_rad": 0.0}, changes)
    start = task.initial_state([np.random.default_rng(0)])
    assert start.robots["franka"].joint_pos[0, 0] == 0.4


@dataclass(frozen=True, kw_only=True)
class AtALine(PickCube):
    """A user's task, whose parameter is a plain field."""

    name: ClassVar[str] = "AtALine"
    line_x_m: float = 0.05

    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        state.objects["cube"].pos[:, 0] = self.line_x_m
        return state


def test_a_plain_field_of_a_users_task_is_named(monkeypatch):
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    TASKS.add("AtALine", AtALine)
    with pytest.raises(ConfigError, match=r"task_kwargs\.line_x_m=… instead"):
        make_task("AtALine", {}, {"objects": {"cube": {"pos": [0.1, 0.0, 0.02]}}})
