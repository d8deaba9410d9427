"""Each contract of a task finds the mistake that it is for, and says what to mend."""

import dataclasses
import re
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest
import torch

from envs.core.registry import PLUGINS_VARIABLE
from envs.scenario import GeomCfg, ObjectCfg, TableCfg
from envs.spec import EnvSpec
from envs.state import EntityState
from envs.tasks import TASKS
from envs.tasks.base import Task
from envs.tasks.pick_cube import PickCube
from roboverse_learn.checks.checked_task import CheckedTask
from roboverse_learn.checks.contract import chosen, run
from roboverse_learn.checks.task_solving import expert_solves
from roboverse_learn.checks.tasks import TASK_CONTRACTS


@dataclass(frozen=True, kw_only=True)
class Broken(PickCube):
    name: ClassVar[str] = "Broken"


BROKEN = []


def broken(contract, message, summary="a task"):
    """Names what the decorated class breaks, and what is said about it."""

    def decorate(cls):
        cls.name = "Broken"
        BROKEN.append(pytest.param(cls, contract, message, summary, id=cls.__name__))
        return cls

    return decorate


@broken("options", "Undecorated is no frozen dataclass. Write @dataclass")
class Undecorated(Broken):
    size_m: float = 0.1


@broken("options", "WithoutDefault has no default of size_m. Give every option one")
@dataclass(frozen=True, kw_only=True)
class WithoutDefault(Broken):
    size_m: float


@broken("options", "Options of Unhashable cannot be hashed .* Use tuples for lists")
@dataclass(frozen=True, kw_only=True)
class Unhashable(Broken):
    sizes_m: list = dataclasses.field(default_factory=list)


@broken("options", "Unfinished lacks success. Define it as envs.tasks.base.Task says")
class Unfinished(Broken):  # its success is abstract again
    success = Task.success


@broken("scenario", "scenario gave two different scenes. Make it of the task's options alone")
class Whimsical(Broken):
    @property
    def scenario(self):
        table = TableCfg(height_m=float(np.random.default_rng().uniform(0.6, 0.8)))
        return dataclasses.replace(super().scenario, table=table)


@broken("scenario", "'bxo'. Did you mean 'box'")
class Shapeless(Broken):
    @property
    def scenario(self):
        return dataclasses.replace(
            super().scenario,
            objects=(ObjectCfg(name="a", geoms=(GeomCfg(shape="bxo", size=(0.1, 0.1, 0.1)),)),),
        )


@broken("words", "instructions is empty. Give a tuple")
class Speechless(Broken):
    instructions = ()


@broken("words", r"instructions has \['lift it '\]")
class Spaced(Broken):
    instructions = ("lift it ",)


@broken("words", "instructions names one sentence twice")
class Twice(Broken):
    instructions = ("lift it", "lift it")


@broken("words", "max_episode_steps is 1. Give a number")
class Short(Broken):
    max_episode_steps = 1


@broken("words", "Add summary='…' to TASKS.add", summary="")
class Unlisted(Broken):
    pass


@broken("initial_states", r"gives the objects \['goal'\]; the scenario has \['cube', 'goal'\]. Give each.")
class WithoutCube(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        return dataclasses.replace(state, objects={"goal": state.objects["goal"]})


@broken("initial_states", "of row 2 differs between a batch of 4 and one alone")
class SharedGenerator(Broken):
    def initial_state(self, rngs):
        return super().initial_state([rngs[0]] * len(rngs))


@broken("initial_states", "gave two answers for equal generators|of row 2 differs")
class OwnGenerator(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        state.objects["cube"].pos[:, 0] = float(np.random.default_rng().uniform())
        return state


@broken("initial_states", r"rot of 'cube' is no unit quaternion \(w, x, y, z\): its length is 2.000")
class LongQuaternion(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        state.objects["cube"].rot *= 2.0
        return state


@broken("initial_states", "'franka' starts outside the limits of joint1. Clip its start")
class OutOfLimits(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        state.robots["franka"].joint_pos[:, 0] = 3.0
        return state


@broken("initial_states", r"pos of 'cube' has the shape \(1, 3\) for 4 generators; it must be \(4, 3\)")
class OneRow(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        one = EntityState.at_rest(np.zeros(3), np.array([[1.0, 0.0, 0.0, 0.0]]))
        return dataclasses.replace(state, objects=state.objects | {"cube": one})


@broken("scene", "success returned torch.float64; it must be torch.bool")
class NumbersForTruth(Broken):
    takes_arrays = False

    def success(self, state):
        return state.objects["cube"].pos[:, 2]


@broken("scene", r"observe returned the shape \(3,\) for 3 states; it must be \(3, D\)")
class Flat(Broken):
    def observe(self, state):
        return state.objects["cube"].pos[:, 0]


@broken("scene", r"KeyError: 'kube' \(test_broken_tasks.py:\d+, in reward\)")
class Misspelt(Broken):
    def reward(self, state):
        return state.objects["kube"].pos[:, 0]


@broken("images", "The image of the camera 'front' has one colour. Check its pos and look_at")
class LooksAway(Broken):
    @property
    def scenario(self):
        own = super().scenario
        camera = dataclasses.replace(own.cameras[0], pos=(0.0, 0.0, 50.0), look_at=(0.0, 0.1, 90.0))
        return dataclasses.replace(own, cameras=(camera,))


@broken("spaces", "Gymnasium's check_env: ")
class Unbounded(Broken):
    def observe(self, state):
        return 1e4 + 0.0 * state.objects["cube"].pos


@broken("deterministic", "environment_state differs after 0 steps of the same seed and actions")
class Noisy(Broken):
    takes_arrays = False

    def observe(self, state):
        pos = state.objects["cube"].pos
        return pos + torch.from_numpy(np.random.default_rng().normal(size=pos.shape))


@broken("starts_vary", "observe returned the same numbers at 30 starts. Draw poses in initial_state")
class Blind(Broken):
    def observe(self, state):
        return 0.0 * state.objects["cube"].pos


@broken("starts_vary", "30 starts have only [12] observations")
class Coarse(Broken):
    def observe(self, state):
        return 1.0 * (state.objects["cube"].pos[:, :1] > 0.0)


@broken("at_rest", r"'cube' moved \d+ mm while the robot held still for 10 s")
class Dropped(Broken):
    def initial_state(self, rngs):
        state = super().initial_state(rngs)
        state.objects["cube"].pos[:, 2] += 0.02
        return state


@broken("not_finite", "success is true for a state of NaN")
class NotBelow(Broken):
    def success(self, state):
        return ~(state.objects["cube"].pos[:, 2] < 0.3)


@broken("touches_nothing", "reward changed objects/cube/pos of the state. Copy before you write")
class Writes(Broken):
    def reward(self, state):
        state.objects["cube"].pos[:, 2] += 1.0
        return 0.0 * state.objects["cube"].pos[:, 2]


@broken("unsolved_at_start", "6 of 6 starts are solved already")
class Easy(Broken):
    def success(self, state):
        return state.objects["cube"].pos[:, 2] > 0.0


@broken("random_fails", r"Random actions solved 3 of 3 episodes in 25 steps")
class Restless(Broken):
    def success(self, state):
        return abs(state.robots["franka"].joint_vel[:, 0]) > 0.05


@broken("random_fails", r"The reward of an unsolved state is 1.500. It must be in \[0, 1\)")
class Rich(Broken):
    def reward(self, state):
        return 1.5 + 0.0 * state.objects["cube"].pos[:, 2]


@broken(
    "expert_solves", r"The expert solved 0 of 6 starts, less than 80 %.* task=Broken split=test episode=0"
)
class Lazy(Broken):
    def expert(self, state, rng):
        return []


@broken("reward_rises", "the last quarter of the way to success is worth no more than the first")
class UpsideDown(Broken):
    def reward(self, state):
        return 0.9 * (1.0 - super().reward(state))


class Spoiled:
    """The expert's planner, with one number of each plan changed."""

    def __init__(self, planner, column, change):
        self._planner, self._column, self._change = planner, column, change

    def plan(self, state, rng):
        plan = self._planner.plan(state, rng)
        plan[len(plan) // 2, self._column] += self._change
        return plan


@broken("expert_is_smooth", r"A joint moves 0.\d+ rad in one control step, more than 0.35")
class Hasty(Broken):
    @property
    def planner(self):
        return Spoiled(super().planner, 0, 0.5)


@broken("expert_in_limits", "The expert's actions leave the limits of gripper/finger_joint1")
class Wide(Broken):
    @property
    def planner(self):
        return Spoiled(super().planner, 7, 0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("cls", "contract", "message", "summary"), BROKEN)
def test_a_broken_task_is_found(monkeypatch, cls, contract, message, summary):
    monkeypatch.setattr(TASKS, "_entries", dict(TASKS._entries))
    TASKS.add("Broken", cls, summary=summary)
    checked = CheckedTask(EnvSpec(task="Broken", image_size=32), episodes=6)
    try:
        finding = list(run(chosen(TASK_CONTRACTS, [contract]), checked))[-1]
    finally:
        checked.close()
    assert (finding.name, finding.result) == (contract, "failed")
    assert re.search(message, finding.detail), finding.detail


@pytest.mark.parametrize(
    ("plugins", "end"), [("", "episode=3"), ("mine,yours", "episode=3 plugins=[mine,yours]")]
)
def test_the_command_that_shows_a_failed_start_names_the_plugins_of_the_task(monkeypatch, plugins, end):
    monkeypatch.setenv(PLUGINS_VARIABLE, plugins)
    episode = SimpleNamespace(success=False, position=3)
    checked = SimpleNamespace(rollouts=[episode], required=0.8, spec=SimpleNamespace(task="Lift"))
    finding = list(run([expert_solves], checked))[-1]
    assert finding.detail.endswith(f"roboverse view task=Lift split=test {end}")
