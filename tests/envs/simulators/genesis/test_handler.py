"""The Genesis handler beyond the contract: agreement with MuJoCo, environments that wait, settings, tasks."""

import dataclasses

import pytest
import torch

pytest.importorskip("genesis", reason="Genesis is not installed: see docs/simulator_costs.md")

from envs.core.errors import ConfigError, SimulatorError, UnknownNameError
from envs.experts.check import check_expert
from envs.scenario import GeomCfg, ObjectCfg, ScenarioCfg
from envs.simulators import HANDLERS
from envs.simulators.genesis.settings import GenesisSettings
from envs.tasks.pick_cube import PickCube
from tests.envs.simulators.reaching import (
    assert_friction_holds_the_lid,
    assert_refused,
    launched,
    reach,
    start,
    with_block,
)

pytestmark = pytest.mark.slow


def test_the_arm_moves_as_in_mujoco():
    """The translated model agrees within 1e-4 rad along a half-second reach, with forces at their limits."""
    assert (reach("mujoco") - reach("genesis")).abs().max() < 1e-4


def test_an_environment_that_waits_forgets_nothing():
    """Environments of a batch step together, and those not selected keep their state."""
    task, ends = PickCube(), []
    with launched("genesis", task.scenario, 3) as handler:
        for waits in (False, True):
            handler.set_states(start(task, 3))
            handler.step(20)  # the cube rests on the table
            if waits:
                handler.step(15, [0, 2])
            handler.step(20, [1])
            ends.append(handler.get_states([1]).flatten())
    for key, value in ends[0].items():
        assert torch.equal(value, ends[1][key]), key


@pytest.mark.parametrize("task", ["PickCube", "CloseBox"])
def test_the_expert_succeeds_in_genesis_physics(task):
    assert check_expert(task, "train", 2, num_envs=2, num_threads=1, simulator="genesis").success_rate == 1.0


def test_the_lid_of_the_box_is_held_by_friction_where_it_was_put():
    assert_friction_holds_the_lid("genesis")


def test_settings_are_read_and_unknown_ones_refused():
    assert GenesisSettings.of(with_block("genesis", iterations=20)).iterations == 20
    assert_refused("genesis", "iteration")
    with pytest.raises(ConfigError, match="max_pairs of genesis must be at least 1, given 0"):
        GenesisSettings(max_pairs=0)
    with pytest.raises(UnknownNameError, match=r"cone of genesis 'round'.*Valid: elliptic, pyramidal"):
        GenesisSettings(cone="round")


def test_its_own_images_are_refused_by_name():
    with pytest.raises(UnknownNameError, match=r"Unknown renderer 'genesis'"):
        HANDLERS.get("genesis")(PickCube().scenario, 1, renderer="genesis")


def test_a_state_that_is_not_finite_is_named_and_another_one_helps():
    ball = ObjectCfg(
        name="ball", geoms=(GeomCfg(shape="sphere", size=(0.05,), mass_kg=0.1),), pos=(0, 0, 0.2)
    )
    with launched("genesis", ScenarioCfg(objects=(ball,), room=None), 2) as handler:
        good = handler.get_states()
        bad = dataclasses.replace(good, objects={"ball": dataclasses.replace(good.objects["ball"])})
        bad.objects["ball"].lin_vel = torch.tensor([[0.0, 0.0, 0.0], [float("nan"), 0.0, 0.0]])
        handler.set_states(bad)
        with pytest.raises(SimulatorError, match=r"cannot continue environments \[1\]: .*nan"):
            handler.step(3)
        handler.set_states(good)
        handler.step(3)
        assert torch.isfinite(handler.get_states().objects["ball"].pos).all()
