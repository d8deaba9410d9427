"""Processes on this machine: their order, their places, and what becomes of failures."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from roboverse_learn.commands.child_process import Children
from roboverse_learn.commands.sigterm import sigterm_interrupts
from roboverse_learn.launch.base import Job
from roboverse_learn.launch.local import gpu_slots, run_jobs
from roboverse_learn.training.interruption import Interrupted


def test_jobs_respect_slots_and_order():
    lock, running, most, order = threading.Lock(), [0], [0], []

    def start(job, slot):
        with lock:
            running[0] += 1
            most[0] = max(most[0], running[0])
            order.append(("start", job.name))
        time.sleep(0.02)
        with lock:
            running[0] -= 1
            order.append(("end", job.name))
        return 0

    jobs = [Job("a", ()), Job("b", ()), *(Job(f"a{i}", (), "a") for i in range(3)), Job("b0", (), "b")]
    codes = run_jobs(jobs, [{"X": "0"}, {"X": "1"}], start, lambda *_: None)
    assert codes == dict.fromkeys(("a", "b", "a0", "a1", "a2", "b0"), 0)
    assert most == [2]
    for name in ("a0", "a1", "a2"):
        assert order.index(("end", "a")) < order.index(("start", name))
    assert order.index(("end", "b")) < order.index(("start", "b0"))


def test_each_process_at_a_time_has_a_slot_of_its_own():
    lock, taken = threading.Lock(), set()

    def start(_job, slot):
        with lock:
            assert slot["X"] not in taken
            taken.add(slot["X"])
        time.sleep(0.01)
        with lock:
            taken.remove(slot["X"])
        return 0

    jobs = [Job(str(i), ()) for i in range(9)]
    run_jobs(jobs, [{"X": "0"}, {"X": "1"}, {"X": "2"}], start, lambda *_: None)


def test_what_follows_a_failure_is_left_out_and_the_rest_is_done():
    calls = []
    jobs = [Job("bad", ()), Job("good", ()), Job("after-bad", (), "bad"), Job("after-good", (), "good")]
    codes = run_jobs(
        jobs,
        [{}],
        lambda job, _: int(job.name == "bad"),
        lambda job, code: calls.append((job.name, code)),
    )
    assert codes == {"bad": 1, "good": 0, "after-bad": None, "after-good": 0}
    assert sorted(calls) == sorted(codes.items())


def test_a_bug_in_a_job_stops_the_sweep():
    def start(_job, _slot):
        raise RuntimeError("broken")

    with pytest.raises(RuntimeError, match="broken"):
        run_jobs([Job("a", ()), Job("b", ())], [{}], start, lambda *_: None)


@pytest.mark.skipif(os.name == "nt", reason="sends SIGTERM to itself")
def test_sigterm_ends_the_jobs_that_run_and_lets_no_other_start(tmp_path):
    children, started = Children(), []
    program = [sys.executable, "-c", "import time; print(1, flush=True); time.sleep(600)"]

    def start(job, _slot):
        started.append(job.name)
        with (tmp_path / f"{job.name}.log").open("wb") as output:
            return children.run(program, output, dict(os.environ))

    def interrupt():
        while not all((tmp_path / f"{name}.log").exists() for name in "ab"):
            time.sleep(0.01)
        while not all((tmp_path / f"{name}.log").read_text() for name in "ab"):
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=interrupt).start()
    jobs = [Job(name, ()) for name in "abcd"]
    with pytest.raises(Interrupted, match="SIGTERM"), sigterm_interrupts():
        run_jobs(jobs, [{}, {}], start, lambda *_: None, children.end)
    assert sorted(started) == ["a", "b"]
    with (tmp_path / "late.log").open("wb") as output:
        assert children.run(program, output, {}) == -signal.SIGTERM


SWEEP = """
import os, sys
from roboverse_learn.commands.child_process import Children
from roboverse_learn.commands.sigterm import sigterm_interrupts
from roboverse_learn.launch.base import Job
from roboverse_learn.launch.local import run_jobs
children = Children()
def start(job, slot):
    with open(sys.argv[1], "ab") as output:
        return children.run([sys.executable, "-c", sys.argv[2]], output, dict(os.environ))
with sigterm_interrupts():
    run_jobs([Job("a", ()), Job("b", ())], [{}], start, lambda *_: None, children.end)
"""
HEARS = """
import signal, time
heard = []
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, lambda number, _: heard.append(number))
print("ready", flush=True)
while len(heard) < {signals}:
    time.sleep(0.01)
time.sleep(0.5)
print(*heard)
"""


def interrupt_sweep(log, signals, *sent):
    """Sends signals to a sweep's process group; returns what its one job heard."""
    words = [sys.executable, "-c", SWEEP, str(log), HEARS.format(signals=signals)]
    sweep = subprocess.Popen(words, start_new_session=True, stderr=subprocess.DEVNULL)
    while not (log.exists() and "ready" in log.read_text()):
        assert sweep.poll() is None
        time.sleep(0.02)
    for number in sent:
        os.killpg(sweep.pid, number)
        time.sleep(0.3)
    assert sweep.wait(60)
    return log.read_text().split()[1:]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no process groups")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_group_of_a_sweep_reaches_a_job_once(tmp_path, number):
    assert interrupt_sweep(tmp_path / "log", 1, number) == ["15"]


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no process groups")
def test_a_second_interruption_of_a_sweep_reaches_a_job_as_well(tmp_path):
    assert interrupt_sweep(tmp_path / "log", 2, signal.SIGINT, signal.SIGINT) == ["15", "15"]


def test_gpus_are_those_that_may_be_seen(monkeypatch):
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert [slot["CUDA_VISIBLE_DEVICES"] for slot in gpu_slots(2)] == ["0", "1", "0", "1"]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "5,7")
    assert [slot["CUDA_VISIBLE_DEVICES"] for slot in gpu_slots(1)] == ["5", "7"]
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert gpu_slots(3) == [{}, {}, {}]
