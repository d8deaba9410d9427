"""What CALVIN's expert sees of a state, and what it does after a miss."""

import numpy as np
import pytest

from envs.state import EntityState
from envs.tasks.calvin.expert import plan
from envs.tasks.calvin.look import look_at
from envs.tasks.calvin.scene import ROBOT as ARM
from tests.envs.tasks.calvin.states import BASE, PLANK, ROBOT, START_POS, block, state

HAND = (0.05, -0.12, 0.6)


def with_hand(given, pos=HAND, gap_m=0.04, target_m=0.0):
    """Adds an arm to a state, its hand pointing down at a place."""
    qpos = np.array([ARM.default_qpos])
    qpos[:, list(ARM.fingers)] = gap_m / 2
    arm = EntityState.at_rest(np.array(ARM.pos), np.array([ARM.rot]), qpos)
    targets = qpos[:, list(ARM.driven)].copy()
    targets[:, -2:] = target_m / 2
    arm.joint_target = arm.joint_pos.new_tensor(targets)
    arm.ee_pos, arm.ee_rot = arm.joint_pos.new_tensor([pos]), arm.joint_pos.new_tensor([[0.0, 1.0, 0.0, 0.0]])
    given.robots[ARM.name] = arm
    return given


def held_state(touched_now):
    in_hand = block(HAND, touched=ROBOT)
    others = {c: block(START_POS[c], touched=touched_now, colour=c) for c in ("blue", "pink")}
    return with_hand(state(start={"red": in_hand}, now={"red": block(HAND)} | others))


def test_a_block_held_at_the_start_is_held_where_no_contact_is_known_yet():
    look = look_at("D", ARM, held_state(touched_now=0), pace=1.0)
    assert look.held == "red" and look.blocks["blue"].touches == BASE


def test_a_block_is_pushed_into_the_drawer_where_no_contact_is_known_yet():
    unknown = {c: block(START_POS[c], colour=c) for c in START_POS}
    given = with_hand(state(joints=(0.0, 0.22, 0.0, 0.0), now=unknown), gap_m=0.08, target_m=0.08)
    assert plan("D", "push_into_drawer", ARM, given, np.random.default_rng(0))


def test_a_block_that_the_hand_lost_is_not_held():
    look = look_at("D", ARM, held_state(touched_now=BASE), pace=1.0)
    assert look.held is None and look.blocks["red"].touches == 0


@pytest.mark.parametrize(("hand", "clears"), [((0.1, -0.05, 0.5), True), ((0.3, -0.15, 0.7), False)])
def test_after_a_miss_in_the_cabinet_what_stands_in_front_of_a_block_is_moved(hand, clears):
    pink = block(START_POS["pink"], (90.0, 0.0, 0.0), PLANK, "pink")
    given = state(joints=(0.28, 0.0, 0.0, 0.0), start={"pink": pink})
    given = with_hand(given, pos=hand, gap_m=0.08, target_m=0.08)
    moved_first = 0
    for seed in range(20):
        points = plan("D", "lift_pink_block_slider", ARM, given, np.random.default_rng(seed))
        moved_first += min(point.pos[1] for point in points if point.gripper < 0.01) < -0.05
    assert (moved_first == 20) if clears else (0 < moved_first < 20)
