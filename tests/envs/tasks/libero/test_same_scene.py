"""Which of LIBERO's tasks share a scene, and which goals can be distinguished there."""

import pytest

from envs.core.errors import MissingExtraError
from envs.tasks.libero.bddl import parse_problem
from envs.tasks.libero.catalogue import entries
from envs.tasks.libero.same_scene import is_another_goal, same_scene_tasks


def problem(goal, first="left", second="right", objects="bowl_1 bowl_2 - bowl plate_1 - plate"):
    """Returns a file with two bowls, one at either place, and a goal."""
    return parse_problem(
        f"""(define (problem LIBERO_Tabletop_Manipulation) (:domain robosuite) (:language Do it)
  (:regions (left (:target main_table) (:ranges ((0.05 0.19 0.07 0.21))))
    (right (:target main_table) (:ranges ((0.25 0.19 0.27 0.21)))) (top_region (:target cabinet_1)))
  (:fixtures main_table - table cabinet_1 - wooden_cabinet) (:objects {objects}) (:obj_of_interest bowl_1)
  (:init (On bowl_1 main_table_{first}) (On bowl_2 main_table_{second})) (:goal (And {goal})))""",
        "a.bddl",
    )


ON_PLATE = "(On bowl_1 plate_1)"


@pytest.mark.parametrize(
    ("other", "is_another"),
    [
        (problem("(In bowl_1 cabinet_1_top_region)"), True),
        (problem(ON_PLATE), False),
        (problem(f"{ON_PLATE} (Close cabinet_1_top_region)"), False),  # doing it does the own task, too
        (problem(ON_PLATE, "right", "left"), True),  # the other of two bowls
        (problem("(On cup_1 plate_1)", objects="bowl_1 bowl_2 - bowl plate_1 - plate cup_1 - cup"), False),
    ],
)
def test_another_goal_is_possible_and_leaves_the_own_open(other, is_another):
    assert is_another_goal(problem(ON_PLATE), other) is is_another


def test_scenes_have_names():
    names = {entry.scene_name for entry in entries().values()}
    assert {"spatial", "object", "goal", "KITCHEN_SCENE1", "STUDY_SCENE4"} <= names and len(names) == 23


@pytest.mark.slow
def test_every_task_has_another_one_in_its_scene():
    try:
        found = {entry: same_scene_tasks(entry) for entry in entries().values()}
    except MissingExtraError as error:
        pytest.skip(str(error))
    assert all(found.values())
    of_goal = [others for entry, others in found.items() if entry.suite == "goal"]
    assert {len(others) for others in of_goal} == {9}
