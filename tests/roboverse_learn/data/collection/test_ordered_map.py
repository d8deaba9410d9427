"""Order, bounds and failures of work in several threads."""

import threading
import time

import pytest

from roboverse_learn.data.collection.ordered_map import side_by_side


@pytest.mark.parametrize("threads", [1, 3])
def test_results_come_in_order_whatever_takes_longest(threads):
    def work(number):
        time.sleep(0.02 if number % 3 == 0 else 0.0)
        return number**2

    assert list(side_by_side(work, range(20), threads)) == [number**2 for number in range(20)]


def test_several_are_worked_on_at_once_and_few_are_held():
    taken, running, most = [], [], []
    lock = threading.Lock()

    def things():
        for number in range(30):
            taken.append(number)
            yield number

    def work(number):
        with lock:
            running.append(number)
            most.append(len(running))
        time.sleep(0.01)
        with lock:
            running.remove(number)
        return number

    results = side_by_side(work, things(), 2)
    assert next(results) == 0
    assert len(taken) <= 5
    assert list(results) == list(range(1, 30))
    assert max(most) == 2


@pytest.mark.parametrize("threads", [1, 2])
def test_what_was_taken_before_a_failure_is_finished(threads):
    def things():
        yield from range(3)
        raise OSError("the source broke")

    seen = []
    with pytest.raises(OSError, match="the source broke"):
        seen.extend(side_by_side(lambda number: number, things(), threads))
    results = side_by_side(lambda number: number, things(), threads)
    assert [next(results) for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 2])
def test_a_failure_of_the_work_is_the_callers(threads):
    def work(number):
        if number == 1:
            raise ValueError("full disk")
        return number

    results = side_by_side(work, range(4), threads)
    assert next(results) == 0
    with pytest.raises(ValueError, match="full disk"):
        next(results)
