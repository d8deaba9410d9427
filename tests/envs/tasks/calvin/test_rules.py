"""CALVIN's rules in states made by hand, on both sides of each threshold."""

import pytest

from envs.core.errors import SimulatorError
from envs.tasks.calvin.catalogue import task_facts
from envs.tasks.calvin.memory import begun_here, bulb, led
from envs.tasks.calvin.rules import may_be_met, met
from envs.tasks.calvin_table import SWITCH_TRAVEL_M
from tests.envs.tasks.calvin.states import BASE, BLOCK, DRAWER, PLANK, ROBOT, START_POS, block, state


def holds(task, given):
    return bool(met(task_facts()[task].rule, given)[0])


def test_nothing_is_solved_where_it_began():
    for task in task_facts():
        assert not holds(task, state()), task


@pytest.mark.parametrize(
    ("euler", "touched", "task", "expected"),
    [
        ((61.0, 0.0, 0.0), BASE, "rotate_red_block_left", True),
        ((59.0, 0.0, 0.0), BASE, "rotate_red_block_left", False),
        ((-61.0, 0.0, 0.0), BASE | ROBOT, "rotate_red_block_right", True),
        ((61.0, 0.0, 0.0), BASE, "rotate_red_block_right", False),
        ((61.0, 0.0, 0.0), ROBOT, "rotate_red_block_left", False),
        ((61.0, 0.0, 0.0), BASE, "rotate_blue_block_left", False),
        ((61.0, 0.0, 31.0), BASE, "rotate_red_block_left", False),
        ((61.0, 31.0, 0.0), BASE, "rotate_red_block_left", False),
    ],
)
def test_a_block_is_turned_by_60_degrees_and_lies(euler, touched, task, expected):
    assert holds(task, state(now={"red": block(START_POS["red"], euler, touched)})) is expected


def test_a_block_that_was_turned_and_moved_by_more_than_10_cm_is_not_rotated():
    for moved, expected in ((0.09, True), (0.11, False)):
        x, y, z = START_POS["red"]
        given = state(now={"red": block((x + moved, y, z), (70.0, 0.0, 0.0), BASE)})
        assert holds("rotate_red_block_left", given) is expected


@pytest.mark.parametrize(
    ("moved", "touched", "task", "expected"),
    [
        (0.101, BASE, "push_red_block_right", True),
        (0.101, BASE | ROBOT, "push_red_block_right", True),
        (0.099, BASE, "push_red_block_right", False),
        (-0.101, BASE, "push_red_block_left", True),
        (0.101, BASE, "push_red_block_left", False),
        (0.101, ROBOT, "push_red_block_right", False),
        (0.101, BASE | PLANK, "push_red_block_right", True),
        (0.101, PLANK, "push_red_block_right", False),
    ],
)
def test_a_block_is_pushed_by_10_cm_on_what_it_lay_on(moved, touched, task, expected):
    x, y, z = START_POS["red"]
    assert holds(task, state(now={"red": block((x + moved, y, z), touched=touched)})) is expected


@pytest.mark.parametrize(
    ("start", "now", "task", "expected"),
    [
        ((0.0, 0.0), (0.151, 0.0), "move_slider_left", True),
        ((0.0, 0.0), (0.149, 0.0), "move_slider_left", False),
        ((0.28, 0.0), (0.12, 0.0), "move_slider_right", True),
        ((0.0, 0.05), (0.0, 0.171), "open_drawer", True),
        ((0.0, 0.1), (0.0, 0.21), "open_drawer", False),
        ((0.0, 0.22), (0.0, 0.09), "close_drawer", True),
    ],
)
def test_door_and_drawer_count_from_where_they_were(start, now, task, expected):
    assert holds(task, state((*now, 0.0, 0.0), (*start, 0.0, 0.0))) is expected


@pytest.mark.parametrize(
    ("colour", "higher", "touched", "task", "expected"),
    [
        ("red", 0.051, ROBOT, "lift_red_block_table", True),
        ("red", 0.049, ROBOT, "lift_red_block_table", False),
        ("red", 0.051, ROBOT | BASE, "lift_red_block_table", False),
        ("red", 0.051, 0, "lift_red_block_table", False),
        ("red", 0.051, ROBOT, "lift_red_block_slider", False),
        ("pink", 0.031, ROBOT, "lift_pink_block_slider", True),
        ("pink", 0.031, ROBOT | PLANK, "lift_pink_block_slider", False),
        ("pink", 0.06, ROBOT, "lift_pink_block_table", False),
    ],
)
def test_a_block_is_lifted_from_what_it_lay_on(colour, higher, touched, task, expected):
    x, y, z = START_POS[colour]
    given = state(now={colour: block((x, y, z + higher), touched=touched, colour=colour)})
    assert holds(task, given) is expected


@pytest.mark.parametrize(
    ("start", "now", "task", "expected"),
    [
        (ROBOT, DRAWER, "place_in_drawer", True),
        (ROBOT, DRAWER | ROBOT, "place_in_drawer", False),
        (ROBOT, DRAWER, "place_in_slider", False),
        (ROBOT, PLANK, "place_in_slider", True),
        (ROBOT | BASE, PLANK, "place_in_slider", False),
        (BASE, PLANK, "place_in_slider", False),
    ],
)
def test_a_block_is_placed_that_began_in_the_hand_and_is_let_go_of(start, now, task, expected):
    given = state(
        start={"red": block((0.0, -0.2, 0.6), touched=start)},
        now={"red": block((0.2, -0.28, 0.36), touched=now)},
    )
    assert holds(task, given) is expected


@pytest.mark.parametrize(
    ("start", "now", "expected"),
    [
        (BASE, DRAWER, True),
        (BASE, DRAWER | ROBOT, False),
        (BASE | ROBOT, DRAWER, False),
        (PLANK, DRAWER, False),
    ],
)
def test_a_block_falls_from_the_desk_into_the_drawer(start, now, expected):
    given = state(
        start={"red": block(START_POS["red"], touched=start)}, now={"red": block((0, 0, 0.36), touched=now)}
    )
    assert holds("push_into_drawer", given) is expected


@pytest.mark.parametrize(
    ("touched", "speed", "expected"),
    [
        (BLOCK["blue"], 0.0, True),
        (BLOCK["blue"], 1.1, False),
        (BLOCK["blue"] | ROBOT, 0.0, False),
        (BLOCK["blue"] | BASE, 0.0, False),
    ],
)
def test_a_block_is_stacked_that_touches_blocks_alone_and_is_slow(touched, speed, expected):
    given = state(now={"red": block((0.23, -0.12, 0.5), touched=touched, speed=speed)})
    assert holds("stack_block", given) is expected


def test_a_block_is_unstacked_when_it_touches_no_block_any_more():
    start = {"red": block((0.23, -0.12, 0.5), touched=BLOCK["blue"])}
    assert not holds("unstack_block", state(start=start))
    assert holds("unstack_block", state(start=start, now={"red": block((0.2, -0.1, 0.6), touched=ROBOT)}))
    beside = {"red": block((0.2, -0.12, 0.46), touched=BASE | BLOCK["blue"])}
    assert not holds("unstack_block", state(start=start, now=beside))


def test_the_bulb_follows_its_switch():
    off, on = (0.0, 0.0, 0.0, 0.043), (0.0, 0.0, 0.0, 0.045)
    assert holds("turn_on_lightbulb", state(on, off))
    assert not holds("turn_on_lightbulb", state(off, off))
    assert holds("turn_off_lightbulb", state(off, on))
    assert [bool(value) for value in bulb(state(on, off))] == [False, True]


def test_the_led_changes_when_the_button_comes_down_and_not_while_it_is_down():
    up, pressed = (0.0,) * 4, (0.0, 0.0, 0.011, 0.0)
    assert holds("turn_on_led", state(pressed, up, led=(False, False)))
    assert holds("turn_off_led", state(pressed, up, led=(True, True)))
    assert not holds("turn_on_led", state(pressed, pressed, led=(False, False)))
    assert not holds("turn_on_led", state(up, up))
    assert not holds("turn_on_led", state(pressed, up, led=(True, True)))


def test_a_state_that_becomes_a_start_keeps_its_lights_and_forgets_how_it_came_about():
    pressed = (0.2, 0.0, 0.011, 0.0)
    given = state(pressed, (0.0,) * 4, led=(False, False))
    assert holds("move_slider_left", given) and holds("turn_on_led", given)
    for name, (pos, rot) in begun_here(given).items():
        given.objects[name].pos, given.objects[name].rot = pos, rot
    assert not holds("move_slider_left", given) and not holds("turn_on_led", given)
    assert [bool(value) for value in led(given)] == [True, True]


def test_a_row_that_goes_on_keeps_its_start_and_notes_its_light():
    given = state((0.2, 0.0, 0.011, 0.0), (0.0,) * 4, led=(False, False))
    for name, (pos, rot) in begun_here(given, rows=[]).items():
        given.objects[name].pos, given.objects[name].rot = pos, rot
    assert holds("move_slider_left", given) and holds("turn_on_led", given)


@pytest.mark.parametrize(
    ("task", "start", "expected"),
    [
        ("place_in_drawer", {}, False),
        ("place_in_drawer", {"red": ROBOT}, True),
        ("place_in_drawer", {"red": ROBOT | BASE}, False),
        ("place_in_drawer", {"red": ROBOT, "blue": ROBOT | BASE}, False),
        ("push_into_drawer", {}, True),
        ("push_into_drawer", {"red": BASE | ROBOT, "blue": BASE | ROBOT}, False),
        ("stack_block", {}, True),
        ("unstack_block", {}, False),
        ("unstack_block", {"red": BLOCK["blue"]}, True),
        ("unstack_block", {"red": BLOCK["blue"] | ROBOT}, False),
        ("lift_red_block_table", {}, True),
        ("lift_red_block_table", {"red": ROBOT}, False),
        ("lift_red_block_slider", {}, False),
        ("push_red_block_left", {}, True),
        ("push_red_block_left", {"red": ROBOT}, False),
        ("open_drawer", {}, True),
        ("rotate_red_block_left", {"red": ROBOT}, True),
        ("push_red_block_left", {"red": ROBOT | BASE}, True),
        ("lift_pink_block_slider", {}, True),
    ],
)
def test_how_an_episode_began_may_rule_out_its_task(task, start, expected):
    began = {colour: block(START_POS[colour], touched=code, colour=colour) for colour, code in start.items()}
    assert bool(may_be_met(task_facts()[task].rule, state(start=began))[0]) is expected


@pytest.mark.parametrize("task", ["led", "lightbulb"])
@pytest.mark.parametrize("lit", [False, True])
@pytest.mark.parametrize("lit_now", [False, True])
def test_a_light_may_be_turned_on_that_was_off_at_the_start(task, lit, lit_now):
    switch = {False: (0.0, 0.0, 0.0, 0.0), True: (0.0, 0.0, 0.0, SWITCH_TRAVEL_M)}
    given = state(joints=switch[lit_now], start_joints=switch[lit], led=(lit, lit_now))
    assert bool(may_be_met(task_facts()[f"turn_on_{task}"].rule, given)[0]) is not lit
    assert bool(may_be_met(task_facts()[f"turn_off_{task}"].rule, given)[0]) is lit


def test_without_contacts_the_rules_say_which_simulators_report_them():
    given = state()
    given.objects["block_red"].touched = None
    with pytest.raises(SimulatorError, match="simulator=mujoco"):
        holds("lift_red_block_table", given)
