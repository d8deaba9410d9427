import numpy as np
import pytest
import torch

from envs.core.errors import DatasetError
from envs.rotations import from_yaw
from envs.state import EntityState, State
from envs.tasks.segment import Segment
from roboverse_learn.data.augmentation.movements import Movement
from roboverse_learn.data.augmentation.pieces import Piece, cut, cut_as_stated, sped_up, vote
from roboverse_learn.data.augmentation.pose import Pose
from roboverse_learn.data.augmentation.recording import SourceDemo

STEP_M = 0.0101


def demo(pos, gripper):
    """A hand that goes through ``pos`` (T, 3) with a gripper of range 0 to 1; a cube is where the hand is."""
    pos, count = np.asarray(pos, float), len(pos)
    hands = np.concatenate([pos[:1], pos])
    robot = EntityState.at_rest(hands, from_yaw(np.zeros(count + 1)))
    robot.ee_pos, robot.ee_rot = torch.tensor(hands), torch.tensor(from_yaw(np.zeros(count + 1)))
    states = State({"arm": robot}, {"cube": EntityState.at_rest(hands, from_yaw(np.zeros(count + 1)))})
    return SourceDemo(0, states, Pose(pos, from_yaw(np.zeros(count))), np.asarray(gripper, float), (0.0, 1.0))


def pick_and_place():
    """Down 20 steps, close, up 20, aside 20, down 20, open, up 20: 1.01 cm each; low is z = 0."""
    down, up, wait = [[0, 0, -STEP_M]] * 20, [[0, 0, STEP_M]] * 20, [[0, 0, 0]] * 5
    steps = [*down, *wait, *up, *[[STEP_M, 0, 0]] * 20, *down, *wait, *up]
    pos = np.cumsum(steps, axis=0) + np.array([0, 0, 20 * STEP_M])
    gripper = np.ones(110)
    gripper[20:85] = 0.0
    return demo(pos, gripper)


def spans(pieces):
    return [(piece.reference, piece.carried, piece.steps[0], piece.steps[-1]) for piece in pieces]


def test_carry_is_cut_where_the_gripper_closes_and_where_the_object_moves():
    movement = Movement("cube", "goal", ((25, 85),))
    pieces = cut(pick_and_place(), [movement], refine=True)
    assert spans(pieces) == [("cube", "", 0, 19), ("cube", "", 20, 24), ("goal", "cube", 25, 109)]
    reach, grasp, carry = pieces
    assert reach.free == (0, 10) and grasp.acts and carry.anchor == 25  # the last 10 cm are the source's
    first, last = carry.free
    assert (first, last) == (5, 47)  # after 5 cm up, until 13 cm above where it opens


def test_grasp_is_no_piece_of_its_own_without_refinement():
    pieces = cut(pick_and_place(), [Movement("cube", "goal", ((25, 85),))], refine=False)
    assert spans(pieces) == [("cube", "", 0, 24), ("goal", "cube", 25, 109)]


def test_next_subtask_begins_where_the_hand_is_clear():
    movements = [Movement("cube", "goal", ((25, 85),)), Movement("box/lid", "box/lid", ((105, 110),))]
    pieces = cut(pick_and_place(), movements, refine=True)
    assert spans(pieces)[2:4] == [("goal", "cube", 25, 96), ("box/lid", "", 97, 104)]
    assert [piece.subtask for piece in pieces] == [0, 0, 0, 1, 1]


def test_reach_of_an_object_that_was_dropped_begins_at_the_second_grasp():
    source = pick_and_place()
    gripper = source.gripper.copy()
    gripper[30:35] = 1.0  # opens and closes again
    again = demo(source.commanded.pos, gripper)
    pieces = cut(again, [Movement("cube", "goal", ((25, 30), (37, 85)))], refine=True)
    assert spans(pieces) == [("cube", "", 30, 34), ("cube", "", 35, 36), ("goal", "cube", 37, 109)]


def test_wandering_before_and_waiting_in_a_piece_are_left_out():
    away, back = [[STEP_M, 0, 0]] * 80, [[-STEP_M, 0, 0]] * 80
    wait, up = [[0, 0, 0]] * 30, [[0, 0, STEP_M]] * 20
    gripper = np.ones(210)
    gripper[160:] = 0.0
    source = demo(np.cumsum([*away, *back, *wait, *up], axis=0), gripper)
    reach, grasp, _ = cut(source, [Movement("cube", "cube", ((190, 210),))], refine=True)
    assert reach.steps[0] == 111 and reach.steps[-1] == 159  # 40 cm of way, and the last 10 cm
    assert len(grasp.steps) == 9 and grasp.steps[-1] < 189  # waits 8 steps of 30


def test_slow_source_is_quickened_but_for_its_grasp():
    pieces = cut(pick_and_place(), [Movement("cube", "goal", ((25, 85),))], refine=True)
    assert sped_up(pieces, 1000) == pieces
    reach, grasp, carry = sped_up(pieces, 32)
    assert len(grasp.steps) == 5
    kept = [len(piece.steps) - (piece.free[1] - piece.free[0]) for piece in (reach, carry)]
    assert sum(kept) == pytest.approx(27, abs=3)
    assert reach.steps[-1] == 19 and carry.steps[-1] == 109


def test_stated_segments_cut_a_demonstration():
    lifted = Segment(reference="cube", until=lambda state: state.robots["arm"].pos[:, 2] < 0.01)
    held = Segment(reference="goal", carries="cube")
    pieces = cut_as_stated(pick_and_place(), (lifted, held), refine=True)
    assert spans(pieces)[-1] == ("goal", "cube", 20, 109) and pieces[0].reference == "cube"
    never = Segment(reference="cube", until=lambda state: state.robots["arm"].pos[:, 2] > 9)
    with pytest.raises(DatasetError, match="its subtask at 'cube' never ends"):
        cut_as_stated(pick_and_place(), (never, held), refine=True)


def piece(reference):
    return Piece(reference=reference, carried="", subtask=0, steps=np.arange(3), anchor=0, free=(0, 0))


def test_most_common_sequence_wins():
    cuts = [(piece("cube"),), (piece("bowl"),), (piece("cube"),), ()]
    assert vote([4, 5, 6, 7], cuts, ["cube", "bowl", "cube", ""]) == [0, 2]


def test_equally_common_sequences_are_named():
    with pytest.raises(DatasetError, match=r"none is the most common \(4: cube carried; 5: bowl carried\)"):
        vote([4, 5], [(piece("cube"),), (piece("bowl"),)], ["cube carried", "bowl carried"])


def test_demonstrations_that_move_nothing_say_what_to_do():
    with pytest.raises(DatasetError, match=r"Lower augment\.least_steps, or state the task's segments"):
        vote([0], [()], [""])
