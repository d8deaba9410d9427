import numpy as np
import pytest

from envs.rotations import from_yaw
from roboverse_learn.data.augmentation.paths import bridged
from roboverse_learn.data.augmentation.pose import Pose

HZ, SPEED = 20.0, 0.8
STILL = np.zeros(3)


def line(count=21, step_m=0.01):
    """A hand that comes down by 1 cm a step."""
    pos = np.zeros((count, 3))
    pos[:, 2] = step_m * np.arange(count)[::-1]
    return Pose(pos, from_yaw(np.zeros(count)))


def bridge(path, start, free, miss=STILL, waits=False, **others):
    return bridged(path, start, free, speed_m_s=SPEED, control_hz=HZ, miss=miss, waits=waits, **others)


def shifted(path, x=0.0, yaw=0.0):
    return Pose(path.pos[0] + [x, 0.0, 0.0], from_yaw(yaw))


def test_path_that_begins_at_the_hand_is_not_changed():
    path = line()
    found = bridge(path, path.rows(0), (0, 0))
    np.testing.assert_array_equal(found.pose.pos, path.pos)
    np.testing.assert_array_equal(found.rows, np.arange(21))


def test_path_is_the_source_after_the_window():
    path = line()
    found = bridge(path, shifted(path, x=0.2, yaw=0.5), (0, 10))
    np.testing.assert_allclose(found.pose.pos[-11:], path.pos[10:], atol=1e-12)
    np.testing.assert_allclose(found.pose.rot[-11:], path.rot[10:], atol=1e-12)
    np.testing.assert_array_equal(found.rows[-11:], np.arange(10, 21))


@pytest.mark.parametrize("x", [0.02, 0.3, 1.0])
def test_bridge_keeps_its_speed(x):
    path = line()
    start = shifted(path, x=x)
    pos = np.concatenate([start.pos[None], bridge(path, start, (0, 10)).pose.pos])
    speeds = np.linalg.norm(np.diff(pos, axis=0), axis=1) * HZ
    assert speeds.max() <= SPEED * 1.05
    assert x < 0.1 or speeds.max() > 0.7 * SPEED  # and is no slower than it need be


def test_carried_object_is_lifted_as_in_the_source_before_the_bridge():
    path = Pose(line().pos[::-1].copy(), from_yaw(np.zeros(21)))  # it goes up
    found = bridge(path, shifted(path, x=0.2), (5, 15))
    np.testing.assert_allclose(found.pose.pos[:5], path.pos[:5] + np.array([0.2, 0, 0]), atol=1e-12)


def test_miss_is_corrected_on_the_way_or_before_it_goes_on():
    path, miss = line(), np.array([0.0, 0.02, 0.0])
    start = shifted(path, x=0.1)
    on_the_way = bridge(path, start, (0, 10), miss)
    waiting = bridge(path, start, (0, 10), miss, waits=True)
    for found in (on_the_way, waiting):
        assert found.pose.pos[:, 1].max() == pytest.approx(0.02)
        np.testing.assert_allclose(found.pose.pos[-1], path.pos[-1], atol=1e-12)
    assert len(waiting.rows) == len(on_the_way.rows) + 3  # 0.1 s and 2 s per metre
    missed = waiting.pose.pos[:, 1] > 1e-9
    assert waiting.pose.pos[missed, 2].min() == pytest.approx(path.pos[10, 2])


def test_hand_turns_the_other_way_round_on_request():
    path = line()
    start = shifted(path, yaw=2.0)
    halves = [bridge(path, start, (0, 0), long_way=way).pose.rot for way in (False, True)]
    yaws = [np.unwrap(2 * np.arctan2(rot[:, 3], rot[:, 0])) for rot in halves]
    assert np.ptp(yaws[0]) < 2.0 < np.ptp(yaws[1]) < 2 * np.pi - 1.9
