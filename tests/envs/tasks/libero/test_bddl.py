"""Task files of LIBERO: what is read, and what is said of one that is damaged."""

import math

import pytest

from envs.core.errors import ConfigError
from envs.tasks.libero.bddl import Atom, parse_problem
from envs.tasks.libero.catalogue import SUITES, entries

TEXT = """(define (problem LIBERO_Tabletop_Manipulation)
  (:domain robosuite) ; a comment (with a parenthesis
  (:language Put the bowl on the plate)
  (:regions
    (plate_region (:target main_table) (:ranges ((0.05 0.19 0.07 0.21))) (:yaw_rotation ((-pi/2 pi))))
    (top_region (:target cabinet_1))
  )
  (:fixtures main_table - table
    cabinet_1 - wooden_cabinet)
  (:objects bowl_1 bowl_2 - akita_black_bowl
    plate_1 - plate)
  (:obj_of_interest bowl_1)
  (:init (On plate_1 main_table_plate_region) (Open cabinet_1_top_region))
  (:goal (And (On bowl_1 plate_1) (In bowl_2 cabinet_1_top_region)))
)
"""


def test_every_part_of_a_file_is_read():
    problem = parse_problem(TEXT, "a.bddl")
    assert problem.name == "LIBERO_Tabletop_Manipulation"
    assert problem.language == "Put the bowl on the plate"
    assert problem.fixtures == {"main_table": "table", "cabinet_1": "wooden_cabinet"}
    assert list(problem.objects.items()) == [
        ("bowl_1", "akita_black_bowl"),
        ("bowl_2", "akita_black_bowl"),
        ("plate_1", "plate"),
    ]
    place, site = problem.regions["main_table_plate_region"], problem.regions["cabinet_1_top_region"]
    assert place.ranges == (0.05, 0.19, 0.07, 0.21) and place.middle == pytest.approx((0.06, 0.2))
    assert place.yaw == pytest.approx((-math.pi / 2, math.pi))
    assert site.ranges is None and (site.target, site.site) == ("cabinet_1", "top_region")
    assert problem.init[1] == Atom("open", ("cabinet_1_top_region",))
    assert problem.goal == (
        Atom("on", ("bowl_1", "plate_1")),
        Atom("in", ("bowl_2", "cabinet_1_top_region")),
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (TEXT[300:], "", r"a.bddl:\d+: it ends inside the '\(' of line \d+: the file is cut off."),
        (TEXT, "", "a.bddl:1: it is empty."),
        (
            "(On bowl_1 plate_1)",
            "(Onto bowl_1 plate_1)",
            r"a.bddl:14: Unknown predicate 'Onto'.*Did you mean",
        ),
        ("(On bowl_1 plate_1)", "(On bowl_1)", r"a.bddl:14: On has 2 argument\(s\), given 1."),
        ("(On bowl_1 plate_1)", "(On bowl_1 plate_9)", "a.bddl:14: Unknown object or region 'plate_9'"),
        ("(And ", "(Or ", r"a.bddl:14: its goal is '\(Or …\)', where only And is known."),
        ("0.05 0.19", "0.05", "a.bddl:5: 4 numbers belong here, given 3."),
        ("0.05 0.19", "0.05 far", "a.bddl:5: 'far' is no number."),
        ("0.05 0.19", "__import__('os') 0.19", r"a.bddl:5: "),
        ("0.05 0.19", "0.08 0.19", "a.bddl:5: the region 'plate_region' ends before it begins"),
        ("(:target main_table)", "", "a.bddl:5: the region 'plate_region' has no ':target'."),
        ("- plate)", ")", "a.bddl:10: 'plate_1' has no type: write 'plate_1 - <type>'."),
        ("(:goal (And", "(:aim (And", r"a.bddl:1: it lacks the part '\(:goal …\)'."),
        ("(define", "(defined", r"a.bddl:1: it does not begin with '\(define'."),
        ("(define", ") (define", "a.bddl:1: a parenthesis closes that was never opened."),
        ("(define", "x (define", r"a.bddl:1: 'x' stands outside '\(define …\)'."),
    ],
)
def test_a_damaged_file_is_named_with_its_line(old, new, message):
    assert old in TEXT
    with pytest.raises(ConfigError, match=message):
        parse_problem(TEXT.replace(old, new, 1), "a.bddl")


def test_a_file_cut_anywhere_is_refused_in_one_line():
    for end in range(len(TEXT.rstrip()) - 1):
        with pytest.raises(ConfigError, match=r"a\.bddl:\d+: ") as caught:
            parse_problem(TEXT[:end], "a.bddl")
        assert "\n" not in str(caught.value)


def test_the_catalogue_has_130_tasks_of_five_suites():
    count = {suite: sum(entry.suite == suite for entry in entries().values()) for suite in SUITES}
    assert count == {"spatial": 10, "object": 10, "goal": 10, "10": 10, "90": 90}
    assert len({entry.class_name for entry in entries().values()}) == 130
    assert all(entry.instruction == entry.instruction.lower().strip() for entry in entries().values())
