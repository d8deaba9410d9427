"""Tasks of reinforcement learning take the same steps in MuJoCo and in MuJoCo Warp."""

import numpy as np
import pytest
import torch

from envs.core.errors import MissingExtraError
from envs.simulators import HANDLERS
from envs.tasks import TASKS
from tests.robot_files import needs_files_of_task
from tests.sweeps import sweep

NUM_ENVS, STEPS = 2, 4
MORE_STEPS = {"control/ant": 12}

QUICK = {"humanoid/pole", "control/ant"}

NAMES = sweep(sorted(TASKS.names("rl")), QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_same_actions_lead_to_the_same_states(name):
    """Some control steps of random actions: states, touches, rewards and ends, to single precision."""
    needs_files_of_task(name)
    task = TASKS.get(name)()
    initial = task.initial_state([np.random.default_rng(i) for i in range(NUM_ENVS)])
    controller, rng = task.rl_controller, np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, (MORE_STEPS.get(name, STEPS), NUM_ENVS, len(controller.names)))
    ends = []
    for simulator in ("mujoco", "mujoco_warp"):
        try:
            handler = HANDLERS.get(simulator)(task.scenario, NUM_ENVS, num_threads=1)
        except MissingExtraError as error:
            pytest.skip(str(error))
        with handler:
            handler.launch()
            handler.set_states(initial.to(handler.device, handler.dtype))
            for action in actions:
                controller.apply(handler, action)
                handler.step(task.scenario.physics.decimation)
            states = handler.get_states().to("cpu", torch.float64)
        ends.append((states.flatten(), task.reward(states), task.failure(states)))
    (first, reward, lost), (second, other_reward, lost_too) = ends
    assert first.keys() == second.keys()
    for key, value in first.items():
        torch.testing.assert_close(
            second[key], value, atol=2e-2 if "vel" in key else 5e-4, rtol=1e-3, msg=key
        )
    torch.testing.assert_close(other_reward, reward, atol=1e-3, rtol=0.0)
    assert torch.equal(lost, lost_too)
