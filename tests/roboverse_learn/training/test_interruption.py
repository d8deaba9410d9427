"""Signals that end training: noted until a step is over, and raised then."""

import signal
import threading

import pytest

from roboverse_learn.training.interruption import Interrupted, signals_noted


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_is_noted_and_raised_at_the_end(number, code):
    before, reached = signal.getsignal(number), []
    with pytest.raises(Interrupted, match=number.name) as raised, signals_noted() as interruption:
        assert not interruption
        signal.raise_signal(number)
        reached.append(bool(interruption))
    assert reached == [True] and raised.value.exit_code == code
    assert signal.getsignal(number) is before


def test_the_second_signal_raises_at_once():
    reached = []
    with pytest.raises(Interrupted, match="SIGINT"), signals_noted():
        signal.raise_signal(signal.SIGTERM)
        reached.append(1)
        signal.raise_signal(signal.SIGINT)
        reached.append(2)
    assert reached == [1]


def test_signal_of_another_process_does_not_count():
    reached = []
    with pytest.raises(Interrupted, match="SIGTERM"), signals_noted() as interruption:
        interruption.hear_of_others()
        signal.raise_signal(signal.SIGTERM)
        reached.append(1)
    assert reached == [1]


def test_error_has_precedence_over_the_signal():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), signals_noted():
        signal.raise_signal(signal.SIGINT)
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


def test_an_ignored_signal_stays_ignored():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with signals_noted() as interruption:
            signal.raise_signal(signal.SIGINT)
            assert not interruption
    finally:
        signal.signal(signal.SIGINT, before)


def test_outside_the_main_thread_nothing_changes():
    handlers = []

    def work():
        with signals_noted():
            handlers.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.getsignal(signal.SIGTERM)]
