"""Robots that are driven by torques, in the simulators that take them, and in one that does not."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from envs.core.errors import SimulatorError
from envs.simulators import HANDLERS
from envs.state import State
from envs.tasks import TASKS

ROWS, STEPS = 2, 20
HEIGHT_M = {"in the air": 5.0, "on the ground": 0.5}


def moved(simulator: str, name: str, *, height_m: float = 0.0, share: float = 0.5) -> np.ndarray:
    """Joint positions, and the root's where it moves, after each of 20 control steps of random torques."""
    task, rng = TASKS.get(f"control/{name}")(), np.random.default_rng(0)
    rows = []
    with HANDLERS.get(simulator)(task.scenario.tuned(simulator, {}), ROWS, num_threads=1) as handler:
        state = task.initial_state([np.random.default_rng(i) for i in range(ROWS)])
        if height_m:
            state.robots[name].pos[:, 2] = height_m
        handler.launch()
        handler.set_states(state)
        for _ in range(STEPS):
            actions = share * rng.uniform(-1.0, 1.0, (ROWS, len(task.controller.names)))
            task.controller.advance(handler, actions, task.scenario.physics.decimation)
            robot = handler.get_states().robots[name]
            rows.append(torch.cat([robot.joint_pos, robot.pos], dim=-1).double().numpy())
    return np.stack(rows)


@pytest.mark.parametrize("where", HEIGHT_M)
def test_an_ant_moves_in_newton_as_in_mujoco(where: str) -> None:
    pytest.importorskip("newton")
    here, there = (moved(simulator, "ant", height_m=HEIGHT_M[where]) for simulator in ("newton", "mujoco"))
    assert np.abs(there[-1] - there[0]).max() > 0.2
    np.testing.assert_allclose(here, there, atol=2e-3)


@pytest.mark.parametrize(("simulator", "apart"), [("newton", 1e-4), ("sapien", 0.01)])
def test_a_cart_is_pushed_as_in_mujoco(simulator: str, apart: float) -> None:
    pytest.importorskip(simulator)
    here, there = (moved(each, "cartpole") for each in (simulator, "mujoco"))
    assert np.abs(there[-1] - there[0]).max() > 0.2
    np.testing.assert_allclose(here, there, atol=apart)


def test_an_ant_turns_its_joints_in_sapien_as_in_mujoco() -> None:
    pytest.importorskip("sapien")
    here, there = (moved(simulator, "ant", height_m=5.0)[:5] for simulator in ("sapien", "mujoco"))
    assert np.abs(there[-1] - there[0]).max() > 0.1
    np.testing.assert_allclose(here, there, atol=0.01)


@pytest.mark.parametrize("simulator", ["newton", "sapien"])
def test_a_torque_is_none_until_one_is_given(simulator: str) -> None:
    pytest.importorskip(simulator)
    task = TASKS.get("control/ant")()
    with HANDLERS.get(simulator)(task.scenario.tuned(simulator, {}), 1, num_threads=1) as handler:
        handler.launch()
        assert not handler.get_states().robots["ant"].joint_target.any()
        state = task.initial_state([np.random.default_rng(0)])
        untold = replace(state.robots["ant"], joint_target=None)
        handler.set_states(State({"ant": untold}, {}))
        assert not handler.get_states().robots["ant"].joint_target.any()


def test_a_simulator_of_positions_alone_is_refused() -> None:
    pytest.importorskip("pybullet")
    scene = TASKS.get("control/cartpole")().scenario
    said = "drives joints to positions, and 'slider_to_cart' is driven by a torque. .*simulator=mujoco"
    with pytest.raises(SimulatorError, match=said):
        HANDLERS.get("pybullet")(scene, 1).launch()
