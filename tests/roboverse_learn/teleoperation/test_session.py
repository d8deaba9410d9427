"""The state machine of one operator, without network and clock: a tick is a call."""

import numpy as np
import pytest

from roboverse_learn.teleoperation.protocol import Button, Move, Press, View
from roboverse_learn.teleoperation.recording import Mark, Recording, recordings_in
from roboverse_learn.teleoperation.scripted_person import ExpertHand, ExpertPerson
from roboverse_learn.teleoperation.session import HOLD_S, PAUSE_S, Phase

RIGHT = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)
HZ = 20


def press(session, button):
    session.submit(Press(button=button))
    session.tick()


def move(session, times=1, **fields):
    for _ in range(times):
        session.submit(Move(**fields))
        session.tick()


def marks(folder):
    return [facts["mark"] for facts in folder.facts.values()]


def hand_x(session):
    return session.station.hand()["pos"][0]


def test_nothing_moves_before_start_and_time_begins_with_the_first_motion(make_session):
    session = make_session()
    assert session.phase is Phase.READY
    before = session.station.state.flatten()
    move(session, rate=RIGHT)
    press(session, Button.START)
    move(session, 5)
    assert session.phase is Phase.RUNNING and session.step == 0
    for key, value in session.station.state.flatten().items():
        assert np.array_equal(value, before[key]), key
    move(session, 3, rate=RIGHT)
    assert session.step == 3


def test_a_rate_moves_at_every_step_and_a_shift_once(make_session):
    session = make_session()
    press(session, Button.START)
    start = hand_x(session)
    move(session, rate=RIGHT)
    session.tick()
    assert hand_x(session) - start == pytest.approx(2 * 0.2 * 0.05, abs=1e-3)
    start = hand_x(session)
    move(session, shift=(0.03, 0.0, 0.0, 0.0, 0.0, 0.0))
    session.tick()
    assert hand_x(session) - start == pytest.approx(0.03, abs=1e-3)


def test_a_burst_of_shifts_is_bounded(make_session):
    session = make_session()
    press(session, Button.START)
    start = hand_x(session)
    for _ in range(40):
        session.submit(Move(shift=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)))
    move(session, 12)
    assert session.station.hand()["pos"][2] < 0.6
    assert abs(hand_x(session) - start) < 0.02


def test_the_arm_is_held_still_and_then_the_episode_waits_while_nothing_arrives(make_session):
    session = make_session()
    press(session, Button.START)
    move(session, 4, rate=RIGHT)
    for _ in range(round(HOLD_S * HZ)):
        session.tick()
    held = hand_x(session)
    for _ in range(10):
        session.tick()
    assert hand_x(session) == held
    for _ in range(round(PAUSE_S * HZ)):
        session.tick()
    assert session.phase is Phase.PAUSED
    steps = session.step
    session.tick()
    assert session.step == steps < PAUSE_S * HZ + 10


def test_a_lost_connection_pauses_at_once_and_start_continues_the_same_episode(make_session):
    session = make_session()
    press(session, Button.START)
    move(session, 6, rate=RIGHT)
    session.connected = False
    state = session.station.state.flatten()
    session.tick()
    session.tick()
    assert session.phase is Phase.PAUSED and "connection" in session.note
    assert all(np.array_equal(value, state[key]) for key, value in session.station.state.flatten().items())
    session.connected = True
    press(session, Button.START)
    move(session, 2, rate=RIGHT)
    assert session.phase is Phase.RUNNING and session.step >= 8


def test_discard_throws_away_and_shows_another_episode(make_session, folder):
    session = make_session()
    first = session.episode
    press(session, Button.START)
    move(session, 3, rate=RIGHT)
    press(session, Button.DISCARD)
    assert session.phase is Phase.READY and session.step == 0
    assert session.episode != first
    assert marks(folder) == [Mark.DISCARDED]


def test_reset_starts_the_same_episode_again(make_session, folder):
    session = make_session()
    first, start = session.episode, session.station.state.flatten()
    press(session, Button.START)
    move(session, 3, rate=RIGHT)
    press(session, Button.RESET)
    assert (session.phase, session.episode) == (Phase.READY, first)
    assert all(np.array_equal(value, start[key]) for key, value in session.station.state.flatten().items())
    assert marks(folder) == [Mark.DISCARDED]


def test_finish_without_success_is_a_failure_and_nothing_is_kept_of_an_episode_that_has_not_begun(
    make_session, folder
):
    session = make_session()
    press(session, Button.FINISH)
    assert marks(folder) == []
    press(session, Button.START)
    move(session, 3, rate=RIGHT)
    press(session, Button.FINISH)
    assert marks(folder) == [Mark.FAILURE]
    assert "failure" in session.note


def test_an_episode_ends_as_a_failure_at_its_limit(make_session, folder):
    session = make_session(limit_s=0.5)
    press(session, Button.START)
    move(session, 10, rate=RIGHT)
    assert marks(folder) == [Mark.FAILURE] and session.phase is Phase.READY


def test_undo_takes_back_a_second_of_an_episode(make_session):
    session = make_session()
    press(session, Button.START)
    move(session, 5, rate=RIGHT)
    there = session.station.state.flatten()
    move(session, 20, rate=(0.0, 0.1, 0.0, 0.0, 0.0, 0.0))
    press(session, Button.UNDO)
    assert (session.step, session.phase) == (5, Phase.PAUSED)
    for key, value in session.station.state.flatten().items():
        assert np.array_equal(value, there[key]), key
    press(session, Button.UNDO)
    assert session.step == 0


def test_an_expert_makes_successes_and_the_newest_can_be_taken_back(make_session, pick_cube, folder):
    session = make_session()
    person = ExpertPerson(session, ExpertHand(session.station, pick_cube.task.planner))
    while session.phase is not Phase.OVER:
        person.tick()
        session.tick()
    assert marks(folder) == [Mark.SUCCESS] * 2
    newest = recordings_in(folder.root)[-1]
    recording = Recording.read(newest)
    assert recording.successes[-6:].all() and not recording.successes[:-6].any()
    assert recording.facts["device"] == "expert" and recording.interventions.all()
    press(session, Button.UNDO)
    assert marks(folder) == [Mark.SUCCESS, Mark.DISCARDED]
    assert session.phase is Phase.READY and session.episode == recording.facts["episode"]
    assert not session.done


def test_two_operators_steer_different_episodes_into_one_folder(make_session, folder):
    one, other = make_session(0), make_session(1)
    assert one.episode != other.episode
    for session in (one, other):
        press(session, Button.START)
        move(session, 2, rate=RIGHT)
        press(session, Button.FINISH)
    assert marks(folder) == [Mark.FAILURE] * 2
    assert len({one.episode, other.episode} | {f["episode"] for f in folder.facts.values()}) == 4


def test_over_when_no_episode_is_left_and_finish_is_then_the_end(make_session):
    session = make_session()
    for _ in range(4):
        press(session, Button.DISCARD)
    assert session.phase is Phase.OVER and session.status()["episode"] is None
    press(session, Button.START)
    assert session.phase is Phase.OVER and not session.done
    press(session, Button.FINISH)
    assert session.done


def test_status_is_plain_and_cameras_are_chosen_among_those_that_there_are(make_session):
    import json

    session = make_session()
    session.submit(View(cameras=("wrist", "moon")))
    session.tick()
    status = json.loads(json.dumps(session.status()))
    assert status["cameras"] == list(session.station.cameras[:1])  # observed are the front camera's alone
    assert status["phase"] == "ready" and status["wanted"] == 2
    assert abs(abs(status["view_yaw"]) - np.pi) < 1e-3  # the front camera looks back at the robot


class Policy:
    """Moves the hand along x, and counts."""

    def __init__(self):
        self.facts = {"policy": "straight"}
        self.begun, self.acted = [], 0

    def begin(self, episode):
        self.begun.append(episode)

    def act(self, station):
        self.acted += 1
        return station.actions_of(np.array([0.05, 0, 0, 0, 0, 0, 1], np.float32))


def test_a_policy_acts_until_the_person_takes_over_and_again_when_handed_back(make_session, folder):
    policy = Policy()
    session = make_session(driver=policy)
    press(session, Button.START)
    steps = session.step
    move(session, 4)
    assert session.acting == "policy" and session.step == steps + 4
    press(session, Button.TAKEOVER)
    move(session, 3, rate=RIGHT)
    press(session, Button.TAKEOVER)
    move(session, 2)
    press(session, Button.FINISH)
    recording = Recording.read(next(iter(folder.facts)))
    assert recording.interventions.sum() in (3, 4)
    assert not recording.interventions[:4].any() and not recording.interventions[-2:].any()
    assert (recording.hand_actions[~recording.interventions] == 0.0).all()
    assert policy.acted == (~recording.interventions).sum()
    assert recording.facts["policy"] == "straight"
    assert policy.begun[:2] == [recording.facts["episode"]] * 2


def test_a_policy_plans_anew_after_undo_and_a_person_who_acts_leaves_it_alone(make_session):
    policy = Policy()
    session = make_session(driver=policy)
    press(session, Button.START)
    move(session, 25)
    assert policy.begun == [session.episode]
    press(session, Button.UNDO)
    assert policy.begun == [session.episode] * 2 and session.acting == "policy"
    press(session, Button.START)
    move(session, 2)
    press(session, Button.TAKEOVER)
    press(session, Button.UNDO)
    assert policy.begun == [session.episode] * 2 and session.acting == "person"


def gripper(session):
    return session.station.gripper()


def test_a_gripper_that_undo_or_a_policy_has_set_is_kept_until_the_person_changes_it(make_session):
    session = make_session()
    press(session, Button.START)
    move(session, 3, rate=RIGHT, gripper=-1.0)
    move(session, 25, gripper=1.0)
    assert gripper(session) == pytest.approx(1.0, abs=1e-3)
    press(session, Button.UNDO)  # to a step at which it was open
    press(session, Button.UNDO)  # to the start
    press(session, Button.START)
    move(session, 3, rate=RIGHT, gripper=-1.0)
    closed = gripper(session)
    move(session, 20, rate=(0.0, 0.0, 0.05, 0.0, 0.0, 0.0), gripper=1.0)
    press(session, Button.UNDO)
    assert gripper(session) == pytest.approx(closed, abs=1e-3)
    press(session, Button.START)
    move(session, 3, rate=RIGHT, gripper=1.0)  # the page has not heard of it yet
    assert gripper(session) == pytest.approx(closed, abs=1e-3)
    move(session, 2, rate=RIGHT, gripper=-1.0)
    move(session, 2, rate=RIGHT, gripper=1.0)
    assert gripper(session) == pytest.approx(1.0, abs=1e-3)


def test_a_session_that_finds_every_success_there_already_is_over_and_can_be_shown(make_session, book):
    book.wanted = 0
    session = make_session()
    assert session.phase is Phase.OVER
    assert session.status()["hand"]["pos"] and session.status()["episode"] is None
