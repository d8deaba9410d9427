"""The Newton handler beyond the contract: agreement with MuJoCo, settings, tasks."""

import pytest

from envs.core.extras import install_command

pytest.importorskip("newton", reason=f"Newton is not installed: {install_command('newton')}")

from envs.core.errors import ConfigError, UnknownNameError
from envs.experts.check import check_expert
from envs.simulators.newton.settings import NewtonSettings
from tests.envs.simulators.reaching import assert_friction_holds_the_lid, assert_refused, reach, with_block


def test_the_arm_moves_as_in_mujoco():
    """The translated model agrees within 1e-4 rad along a half-second reach."""
    ways = [reach("mujoco"), reach("newton")]
    assert (ways[0] - ways[1]).abs().max() < 1e-4


def test_the_lid_of_the_box_is_held_by_friction_where_it_was_put():
    assert_friction_holds_the_lid("newton")


@pytest.mark.slow
@pytest.mark.parametrize("task", ["PickCube", "CloseBox"])
def test_the_expert_succeeds_in_newtons_physics(task):
    report = check_expert(task, "train", 2, num_envs=2, num_threads=1, simulator="newton")
    assert report.success_rate == 1.0


def test_settings_are_read_and_unknown_ones_refused():
    assert NewtonSettings.of(with_block("newton", iterations=20)).iterations == 20
    assert_refused("newton", "iteration")
    with pytest.raises(ConfigError, match="iterations of newton must be at least 1, given 0"):
        NewtonSettings(iterations=0)
    with pytest.raises(UnknownNameError, match=r"Unknown cone of newton 'round'.*Valid: "):
        NewtonSettings(cone="round")
