"""Batch jobs of Slurm, by programs of its names that keep a queue of real processes."""

import json
import os
import shlex
import sys
import threading
import time
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, UnknownNameError
from roboverse_learn.launch import make_launcher
from roboverse_learn.launch.base import Job
from roboverse_learn.launch.slurm import ENDED_BY_SLURM, SUBMITTED, SlurmLauncher, SlurmSettings
from roboverse_learn.sweep import SweepError, plan, sweep

FAKE = Path(__file__).with_name("fake_slurm.py")


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """A folder with a queue; sbatch, squeue and scancel are the first programs on the path."""
    bin_folder, folder = tmp_path / "bin", tmp_path / "cluster"
    bin_folder.mkdir()
    folder.mkdir()
    for name in ("sbatch", "squeue", "scancel"):
        program = bin_folder / name
        words = shlex.join([sys.executable, str(FAKE), str(folder), name])
        program.write_text(f'#!/bin/sh\nexec {words} "$@"\n')
        program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{bin_folder}{os.pathsep}{os.environ['PATH']}")
    return folder


@pytest.fixture
def logs(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    return folder


class ShellJob(Job):
    """A job whose only word is a line of shell."""

    @property
    def program(self):
        return ["bash", "-c", self.words[0]]


def run(jobs, logs, **settings):
    ends = []
    launcher = SlurmLauncher(SlurmSettings(poll_s=0.05, **settings))
    codes = launcher.run(jobs, logs, lambda job, code: ends.append((job.name, code)))
    assert sorted(ends, key=str) == sorted(codes.items(), key=str)
    return codes


def submitted(cluster):
    return [json.loads(path.read_text()) for path in sorted(cluster.glob("*.args"))]


@pytest.mark.slow
def test_each_job_waits_for_its_own_and_what_follows_a_failure_is_left_out(cluster, logs, tmp_path):
    jobs = [
        ShellJob("good", (f"sleep 0.3; echo made > {tmp_path}/made",)),
        ShellJob("bad", ("echo no luck; exit 3",)),
        ShellJob("after-good", (f"cat {tmp_path}/made",), "good"),
        ShellJob("after-bad", (f"touch {tmp_path}/never",), "bad"),
    ]
    codes = run(jobs, logs)
    assert codes == {"good": 0, "bad": 3, "after-good": 0, "after-bad": None}
    assert (logs / "after-good.log").read_text() == "made\n"
    assert (logs / "bad.log").read_text() == "no luck\n"
    assert not (tmp_path / "never").exists()


@pytest.mark.slow
def test_sbatch_is_asked_for_what_the_settings_say(cluster, logs, monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    settings = {
        "partition": "gpu",
        "account": "lab",
        "time": "4:00:00",
        "gpus": 2,
        "cpus": 6,
        "memory_gb": 64,
        "setup": "MODULE=cuda",
        "options": ("--qos=high",),
    }
    job = ShellJob("a", ("echo $OMP_NUM_THREADS",))
    assert run([job, ShellJob("b", ("true",), "a")], logs, **settings) == {"a": 0, "b": 0}
    first, second = submitted(cluster)
    assert first == [
        "--parsable",
        "--job-name=a",
        f"--chdir={os.getcwd()}",
        f"--output={logs}/a.log",
        "--open-mode=append",
        "--cpus-per-task=6",
        "--partition=gpu",
        "--account=lab",
        "--time=4:00:00",
        "--gres=gpu:2",
        "--mem=64G",
        "--qos=high",
    ]
    assert second[-3:] == ["--dependency=afterok:1", "--kill-on-invalid-dep=yes", "--qos=high"]
    assert (logs / "a.log").read_text() == "6\n"
    assert "MODULE=cuda\n" in (cluster / "00001.script").read_text()


@pytest.mark.slow
def test_a_setup_that_fails_is_the_end_of_the_job(cluster, logs, tmp_path):
    assert run([ShellJob("a", (f"touch {tmp_path}/never",))], logs, setup="false") == {"a": 1}
    assert not (tmp_path / "never").exists()


@pytest.mark.slow
def test_an_interrupted_sweep_watches_its_jobs_again_and_submits_none_twice(
    cluster, logs, tmp_path, monkeypatch
):
    go = tmp_path / "go"
    waits = f"while [ ! -e {go} ]; do sleep 0.02; done; echo once"
    jobs = [ShellJob("long", (waits,)), ShellJob("next", ("echo twice",), "long")]

    def interrupt(_seconds):
        raise KeyboardInterrupt

    def let_go(seconds):
        go.touch()
        real_sleep(seconds)

    real_sleep = time.sleep
    monkeypatch.setattr("roboverse_learn.launch.slurm.time.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(jobs, logs)
    monkeypatch.setattr("roboverse_learn.launch.slurm.time.sleep", let_go)
    assert run(jobs, logs) == {"long": 0, "next": 0}
    assert len(submitted(cluster)) == 2
    assert (logs / "long.log").read_text() == "once\n"
    other = [ShellJob("long", ("echo other words",))]  # no work of the one that ended
    assert run(other, logs) == {"long": 0}
    assert len(submitted(cluster)) == 3


@pytest.mark.slow
def test_sweeps_that_start_at_once_keep_each_others_jobs(cluster, logs):
    codes, sweeps = {}, []

    def start(job):
        sweeps.append(threading.Thread(target=lambda: codes.update(run([job], logs))))
        sweeps[-1].start()

    class Slow(ShellJob):
        """While it is submitted, another sweep starts, and has time to submit its own job."""

        @property
        def program(self):
            start(ShellJob("other", ("true",)))
            end = time.monotonic() + 2.0
            while not (logs / SUBMITTED).exists() and time.monotonic() < end:
                time.sleep(0.02)
            return super().program

    start(Slow("slow", ("exit 3",)))
    for one in sweeps:  # grows by the other sweep while the first is waited for
        one.join()
    assert codes == {"slow": 3, "other": 0}
    assert json.loads((logs / SUBMITTED).read_text()) == {"roboverse 'exit 3'": "1", "roboverse true": "2"}


@pytest.mark.slow
def test_a_job_that_slurm_kills_has_failed(cluster, logs, tmp_path):
    kills = f"sleep 0.2; {tmp_path}/bin/scancel 1; sleep 20"
    started = time.monotonic()
    assert run([ShellJob("a", (kills,)), ShellJob("b", ("true",), "a")], logs) == {
        "a": ENDED_BY_SLURM,
        "b": None,
    }
    assert time.monotonic() - started < 15.0


@pytest.mark.slow
def test_a_queue_that_does_not_answer_for_a_while_ends_no_job(cluster, logs, caplog):
    down, refused = cluster / "down", cluster / "refused"
    job = ShellJob("a", (f"touch {down}; while [ ! -e {refused} ]; do sleep 0.02; done; rm {down}",))
    assert run([job], logs) == {"a": 0}
    assert "squeue failed and is tried again: no contact" in caplog.text


@pytest.mark.slow
def test_nothing_is_submitted_where_the_queue_cannot_be_seen(cluster, logs):
    (cluster / "down").touch()
    with pytest.raises(ConfigError, match="squeue failed, so nothing was submitted"):
        run([ShellJob("a", ("true",))], logs)
    assert submitted(cluster) == []


@pytest.mark.slow
def test_a_refusal_of_sbatch_is_shown(cluster, logs):
    with pytest.raises(ConfigError, match="sbatch refused a: invalid partition"):
        run([ShellJob("a", ("true",))], logs, partition="missing")


def test_a_machine_without_slurm_is_told_apart(logs, monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigError, match="needs sbatch, which is not on this machine"):
        run([ShellJob("a", ("true",))], logs)


@pytest.mark.parametrize(
    ("settings", "jobs_per_gpu", "error", "said"),
    [
        ({"partitoin": "gpu"}, 1, UnknownNameError, "Did you mean 'partition'"),
        ({"gpus": "two"}, 1, ConfigError, r"launcher_settings\.gpus: "),
        ({"gpus": -1}, 1, ConfigError, r"launcher_settings\.gpus must be 0 or more, given -1"),
        ({"poll_s": 0}, 1, ConfigError, r"launcher_settings\.poll_s must be above 0"),
        ({}, 2, ConfigError, "jobs_per_gpu=2 shares the GPUs of this machine"),
    ],
)
def test_wrong_settings_are_refused_before_anything_starts(settings, jobs_per_gpu, error, said):
    with pytest.raises(error, match=said):
        make_launcher("slurm", settings, jobs_per_gpu)


@pytest.mark.slow
def test_a_sweep_runs_as_batch_jobs(cluster, tmp_path, monkeypatch):
    fake = tmp_path / "python"
    fake.write_text('#!/bin/sh\necho "$@"\ncase "$*" in *seed=1*) echo "error: no luck"; exit 1;; esac\n')
    fake.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(fake))
    words = ["seed=0,1", f"runs_dir={tmp_path}/runs", f"results_dir={tmp_path}/results"]
    slurm = ["launcher=slurm", "launcher_settings.poll_s=0.05", "launcher_settings.gpus=0"]
    with pytest.raises(SweepError, match=r"1 of 3 processes failed(.|\n)*error: no luck"):
        sweep(plan([*words, *slurm]))
    collect = (tmp_path / "runs" / "sweep-logs").glob("collect-*.log")
    assert next(collect).read_text().startswith("-m roboverse_learn.cli collect")
    assert "0 done, 0 started, 2 open" in (tmp_path / "runs" / "sweep-logs" / "progress.txt").read_text()
