"""Batch jobs of a Slurm cluster, whose nodes see this machine's folders.

Jobs are submitted by ``sbatch`` and watched by ``squeue``. Each writes its exit code beside its log, so that
no accounting database is needed. What was submitted is kept in ``slurm.json``: the same command, run again,
watches the jobs that are still in the queue instead of submitting them twice.
"""

import getpass
import json
import logging
import os
import shlex
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, override

from envs.core.atomic import write_file
from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges
from roboverse_learn.folder_lock import lock_directory
from roboverse_learn.launch.base import Job, Launcher, OnEnd

log = logging.getLogger(__name__)

SUBMITTED = "slurm.json"
"""File in the folder of logs: Slurm's number of each job by its command."""

ENDED_BY_SLURM = 137
"""Exit code of a job that left the queue without one: out of time or memory, or cancelled."""

GONE_POLLS = 3
"""Polls after which a job that left the queue has no exit code: a shared folder may show it late."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SlurmSettings:
    """Settings of ``launcher=slurm``; what is empty is the cluster's default.

    Attributes:
        partition: Partition of the cluster.
        account: Account that pays.
        time: Longest time of a job, as Slurm writes it: 4:00:00 is four hours.
        gpus: GPUs of a job; 0 asks for none.
        cpus: CPU cores of a job.
        memory_gb: Memory of a job, GB; 0 is the cluster's default.
        setup: Line of shell that a job begins with, such as "module load cuda".
        options: Further options of sbatch, as in [--qos=high,--exclude=node7].
        poll_s: Time between two looks at the queue, s.
    """

    partition: str = ""
    account: str = ""
    time: str = ""
    gpus: int = 1
    cpus: int = 8
    memory_gb: int = 0
    setup: str = ""
    options: tuple[str, ...] = ()
    poll_s: float = 30.0

    def __post_init__(self) -> None:
        check_ranges(self, "launcher_settings.", from_1=("cpus",), from_0=("gpus", "memory_gb"))
        check_ranges(self, "launcher_settings.", above_0=("poll_s",))


class SlurmLauncher(Launcher):
    """A batch job for each process; all are submitted at once, and Slurm keeps their order.

    Jobs outlive this process.
    """

    settings_class = SlurmSettings
    settings: SlurmSettings

    def __init__(self, settings: SlurmSettings, jobs_per_gpu: int = 1) -> None:
        super().__init__(settings, jobs_per_gpu)
        if jobs_per_gpu != 1:
            raise ConfigError(
                f"jobs_per_gpu={jobs_per_gpu} shares the GPUs of this machine. With launcher=slurm leave it "
                "out, and ask for a share of a GPU as your cluster has it: launcher_settings.gpus=0 "
                "launcher_settings.options=[--gres=shard:1]"
            )

    @override
    def run(self, jobs: Sequence[Job], logs: Path, on_end: OnEnd) -> dict[str, int | None]:
        for program in ("sbatch", "squeue", "scancel"):
            if shutil.which(program) is None:
                raise ConfigError(
                    f"launcher=slurm needs {program}, which is not on this machine. Run the sweep on a "
                    "machine that submits jobs of the cluster, or leave out launcher=slurm."
                )
        logs = logs.resolve()
        lock = lock_directory(logs, wait=True)  # sweeps of one folder add to the same file
        try:
            numbers = self._submit(jobs, logs)
        finally:
            lock.release()
        try:
            return self._watch(jobs, numbers, logs, on_end)
        except KeyboardInterrupt:
            log.info(
                "Submitted jobs stay in the queue, and the same command watches them again. "
                "This cancels them: scancel %s",
                " ".join(numbers.values()),
            )
            raise

    def _submit(self, jobs: Sequence[Job], logs: Path) -> dict[str, str]:
        """Submits the jobs that are not in the queue yet; returns Slurm's number of each by its name."""
        kept, queued = _read(logs / SUBMITTED), self._queue()
        if queued is None:
            raise ConfigError("squeue failed, so nothing was submitted. Is Slurm up? Try: squeue")
        numbers: dict[str, str] = {}
        for job in jobs:
            if kept.get(job.command) not in queued:
                _code_file(logs, job).unlink(missing_ok=True)
                kept[job.command] = self._sbatch(job, numbers.get(job.after or ""), logs)
                write_file(logs / SUBMITTED, json.dumps(kept, indent=1).encode())
            numbers[job.name] = kept[job.command]
        again = sum(number in queued for number in numbers.values())
        log.info("%d jobs submitted to Slurm; %d were in its queue.", len(jobs) - again, again)
        return numbers

    def _sbatch(self, job: Job, after: str | None, logs: Path) -> str:
        command = ["sbatch", "--parsable", *self._options(job, after, logs)]
        done = subprocess.run(command, input=self._script(job, logs), text=True, capture_output=True)
        if done.returncode != 0:
            raise ConfigError(
                f"sbatch refused {job.name}: {done.stderr.strip() or done.returncode}. Change "
                f"launcher_settings, and run the same command again. It was called as: {shlex.join(command)}"
            )
        return done.stdout.strip().partition(";")[0]  # the cluster's name may follow

    def _options(self, job: Job, after: str | None, logs: Path) -> list[str]:
        own = self.settings
        given: Mapping[str, Any] = {
            "job-name": job.name,
            "chdir": os.getcwd(),
            "output": logs / f"{job.name}.log",
            "open-mode": "append",
            "cpus-per-task": own.cpus,
            "partition": own.partition,
            "account": own.account,
            "time": own.time,
            "gres": f"gpu:{own.gpus}" if own.gpus else "",
            "mem": f"{own.memory_gb}G" if own.memory_gb else "",
            "dependency": f"afterok:{after}" if after else "",
            "kill-on-invalid-dep": "yes" if after else "",
        }
        return [f"--{name}={value}" for name, value in given.items() if value != ""] + list(own.options)

    def _script(self, job: Job, logs: Path) -> str:
        code = shlex.quote(str(_code_file(logs, job)))
        return "\n".join(
            (
                "#!/bin/bash",
                "(",
                "set -e",
                self.settings.setup,
                'export OMP_NUM_THREADS="${OMP_NUM_THREADS:-${SLURM_CPUS_PER_TASK:-1}}"',
                shlex.join(job.program),
                ")",
                "code=$?",
                f"echo $code > {code}.part && mv {code}.part {code}",
                "exit $code",
                "",
            )
        )

    def _watch(
        self, jobs: Sequence[Job], numbers: Mapping[str, str], logs: Path, on_end: OnEnd
    ) -> dict[str, int | None]:
        codes: dict[str, int | None] = {}
        gone: Counter[str] = Counter()
        said: dict[str, int] = {}
        while len(codes) < len(jobs):
            queued = self._queue()
            for job in jobs:
                if job.name in codes:
                    continue
                if job.after is not None and codes.get(job.after, 0) != 0:
                    subprocess.run(["scancel", numbers[job.name]], capture_output=True)
                    codes[job.name] = None
                else:
                    code = _read_code(_code_file(logs, job))
                    gone[job.name] += queued is not None and numbers[job.name] not in queued
                    if code is None and gone[job.name] < GONE_POLLS:
                        continue
                    codes[job.name] = ENDED_BY_SLURM if code is None else code
                on_end(job, codes[job.name])
            states = Counter(state for number, state in (queued or {}).items() if number in numbers.values())
            if queued is not None and states != said:
                said = dict(states)
                counts = ", ".join(f"{count} {state.lower()}" for state, count in sorted(said.items()))
                log.info("Slurm: %s", counts or "none in the queue")
            if len(codes) < len(jobs):
                time.sleep(self.settings.poll_s)
        return codes

    def _queue(self) -> dict[str, str] | None:
        """Returns the state of each of this user's jobs by number; None where Slurm does not answer."""
        command = ["squeue", "--noheader", f"--user={getpass.getuser()}", "--format=%i %T"]
        done = subprocess.run(command, text=True, capture_output=True)
        if done.returncode != 0:
            log.warning("squeue failed and is tried again: %s", done.stderr.strip() or done.returncode)
            return None
        return dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if line.strip())


def _code_file(logs: Path, job: Job) -> Path:
    return logs / f"{job.name}.code"


def _read_code(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        return None


def _read(path: Path) -> dict[str, str]:
    """Returns the numbers of jobs submitted before; none where the file is absent or broken."""
    try:
        return {str(name): str(number) for name, number in json.loads(path.read_text()).items()}
    except (OSError, ValueError, AttributeError):
        return {}
