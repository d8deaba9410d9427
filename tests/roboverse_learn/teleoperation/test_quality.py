import numpy as np
import pytest

from envs.robots.franka import FRANKA
from roboverse_learn.teleoperation.quality import Quality, mean, measure


def states(pos, *, turn_rad=None, finger_m=None):
    count = len(pos)
    joints = np.tile(np.array(FRANKA.default_qpos), (count, 1))
    if finger_m is not None:
        joints[:, -2:] = np.array(finger_m)[:, None]
    half = np.zeros(count) if turn_rad is None else np.array(turn_rad) / 2
    rot = np.stack([np.cos(half), np.zeros(count), np.zeros(count), np.sin(half)], axis=1)
    prefix = "robots/franka/"
    return {f"{prefix}ee_pos": np.array(pos), f"{prefix}ee_rot": rot, f"{prefix}joint_pos": joints}


def test_figures_of_a_path_are_those_of_hand():
    # 3 cm, rest, 4 cm, rest: four steps at 20 Hz
    path = [(0.0, 0, 0), (0.03, 0, 0), (0.03, 0, 0), (0.03, 0.04, 0), (0.03, 0.04, 0)]
    found = measure(states(path), FRANKA, 20.0)
    assert found == Quality(seconds=0.2, path_m=pytest.approx(0.07), idle_share=0.5)
    assert found.to_json() == {"seconds": 0.2, "path_m": 0.07, "idle_share": 0.5}


def test_a_hand_that_turns_or_grips_is_not_idle():
    still = [(0.0, 0, 0)] * 3
    assert measure(states(still), FRANKA, 20.0).idle_share == 1.0
    assert measure(states(still, turn_rad=[0.0, 0.02, 0.02]), FRANKA, 20.0).idle_share == 0.5
    assert measure(states(still, finger_m=[0.04, 0.04, 0.03]), FRANKA, 20.0).idle_share == 0.5


def test_mean_of_no_episode_is_none():
    assert mean([]) is None
    both = mean([Quality(seconds=1, path_m=2, idle_share=0), Quality(seconds=3, path_m=2, idle_share=1)])
    assert both == Quality(seconds=2, path_m=2, idle_share=0.5)
