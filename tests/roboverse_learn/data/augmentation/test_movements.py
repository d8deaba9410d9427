import numpy as np
import pytest

from roboverse_learn.data.augmentation.movements import Movement, movements, stretches
from roboverse_learn.data.augmentation.pieces import cut
from roboverse_learn.data.augmentation.references import References
from tests.roboverse_learn.data.augmentation.expert_demos import expert_demos
from tests.sweeps import sweep

SEQUENCES = {
    "PickCube": "cube carried to goal",
    "StackCube": "cube_a carried to cube_b",
    "CloseBox": "box_base/box_joint moved",
    "MoveSliderLeft": "play_table/base__slide moved",
    "PickChocolatePudding": "chocolate_pudding carried to basket",
    "NutAssemblySquare": "square_nut carried to square_peg",
    "NutAssembly": "square_nut carried to square_peg, then round_nut carried to round_peg",
}


def test_stretches_close_short_holes_and_drop_short_runs():
    mask = np.array([0, 1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0], bool)
    assert stretches(mask, least=4) == [(1, 7)]
    assert stretches(mask, least=1) == [(1, 7), (11, 12)]
    assert stretches(mask, least=4, gap=1) == []


def test_movement_in_words():
    assert str(Movement("cube", "goal", ((1, 5),))) == "cube carried to goal"
    assert str(Movement("cube", "cube", ((1, 5),))) == "cube carried"
    assert str(Movement("box/lid", "box/lid", ((1, 5),))) == "box/lid moved"


@pytest.mark.slow
@pytest.mark.parametrize("task", sweep(SEQUENCES, always={"PickCube", "CloseBox"}))
def test_sequence_of_the_experts_demonstrations_is_found(task):
    made, demos = expert_demos(task)
    references, hz = References(made.scenario), made.scenario.physics.control_hz
    for demo in demos:
        found = movements(demo, references, hz, least=4)
        assert ", then ".join(map(str, found)) == SEQUENCES[task]
        for movement, pieces in zip(found, _by_subtask(cut(demo, found, refine=True)), strict=True):
            is_part = "/" in movement.moved
            assert [piece.reference for piece in pieces] == (
                [movement.moved] * 2 if is_part else [movement.moved, movement.moved, movement.target]
            )
            assert pieces[-1].carried == ("" if is_part else movement.moved)
            assert all(len(piece.steps) > 1 for piece in pieces)


def _by_subtask(pieces):
    count = pieces[-1].subtask + 1
    return [[piece for piece in pieces if piece.subtask == number] for number in range(count)]
