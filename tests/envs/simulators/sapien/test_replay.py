"""Episodes that were played in MuJoCo, put state by state into SAPIEN, and the expert in SAPIEN's physics."""

import numpy as np
import pytest
import torch

from envs.core.extras import install_command

pytest.importorskip("sapien", reason=f"SAPIEN is not installed: {install_command('sapien')}")

from envs.experts.actor import expert_episodes
from envs.experts.check import check_expert
from envs.gym_env import make_vec
from envs.simulators import HANDLERS
from envs.state import State

TASKS = ("PickCube", "StackCube", "CloseBox")


@pytest.mark.parametrize("task", TASKS)
def test_states_of_an_episode_are_judged_alike(task):
    env = make_vec(task, 2, split="train", observation="state", num_threads=1)
    episodes = list(expert_episodes(env, env.split_indices[:2].tolist()))
    verdicts = []
    with HANDLERS.get("sapien")(env.scenario, 64, renderer="warp") as handler:
        handler.launch()
        for episode in episodes:
            count = len(episode.actions) + 1
            for first in range(0, count, 64):
                rows = slice(first, min(first + 64, count))
                states = State.unflatten(
                    {key: torch.from_numpy(value[rows]) for key, value in episode.raw.items()}
                )
                ids = np.arange(states.num_envs)
                handler.set_states(states, ids)
                shown = handler.get_states(ids)
                assert torch.equal(env.task.success(shown), env.task.success(states))
                verdicts += env.task.success(shown).tolist()
                for name, robot in states.robots.items():
                    ours = shown.robots[name].ee_pos
                    assert ours is not None
                    assert robot.ee_pos is not None
                    assert (ours - robot.ee_pos).abs().max() < 1e-5
    env.close()
    assert any(verdicts)
    assert not all(verdicts)


@pytest.mark.parametrize("task", TASKS)
def test_the_expert_succeeds_in_sapiens_physics(task):
    report = check_expert(task, "train", 2, num_envs=2, num_threads=1, simulator="sapien")
    assert report.success_rate == 1.0
