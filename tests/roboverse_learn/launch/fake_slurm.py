"""The least of sbatch, squeue and scancel: ``fake_slurm.py <folder> <program> <arguments>``.

The folder has of each job the arguments, the script, the state while it is in the queue, and the exit code.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def sbatch(folder: Path, arguments: list[str]) -> int:
    options = dict(word.removeprefix("--").partition("=")[::2] for word in arguments)
    if options.get("partition") == "missing":
        print("invalid partition", file=sys.stderr)
        return 1
    number = len(list(folder.glob("*.args"))) + 1
    job = folder / f"{number:05d}"
    job.with_suffix(".args").write_text(json.dumps(arguments))
    job.with_suffix(".script").write_text(sys.stdin.read())
    job.with_suffix(".state").write_text("PENDING")
    words = [sys.executable, __file__, str(folder), "run", str(number), json.dumps(options)]
    nowhere = subprocess.DEVNULL
    subprocess.Popen(words, start_new_session=True, stdin=nowhere, stdout=nowhere, stderr=nowhere)
    print(f"{number};cluster")
    return 0


def run(folder: Path, number: int, options: dict[str, str]) -> int:
    job = folder / f"{number:05d}"
    state = job.with_suffix(".state")
    if "dependency" in options:
        before = folder / f"{int(options['dependency'].removeprefix('afterok:')):05d}"
        while before.with_suffix(".state").exists():
            time.sleep(0.02)
        if before.with_suffix(".ended").read_text() != "0":
            state.unlink(missing_ok=True)
            return 0
    state.write_text("RUNNING")
    job.with_suffix(".pid").write_text(str(os.getpid()))
    environment = os.environ | {"SLURM_CPUS_PER_TASK": options["cpus-per-task"]}
    with open(options["output"], "ab") as output:
        script = str(job.with_suffix(".script"))
        code = subprocess.run(
            ["bash", script], cwd=options["chdir"], env=environment, stdout=output, stderr=output
        ).returncode
    job.with_suffix(".ended").write_text(str(code))
    state.unlink(missing_ok=True)
    return 0


def squeue(folder: Path) -> int:
    if (folder / "down").exists():
        (folder / "refused").touch()
        print("no contact", file=sys.stderr)
        return 1
    for state in sorted(folder.glob("*.state")):
        print(int(state.stem), state.read_text() or "RUNNING")
    return 0


def scancel(folder: Path, number: int) -> int:
    job = folder / f"{number:05d}"
    job.with_suffix(".ended").write_text("killed")
    job.with_suffix(".state").unlink(missing_ok=True)
    pid = job.with_suffix(".pid")
    if pid.exists():
        os.killpg(int(pid.read_text()), signal.SIGKILL)
    return 0


def main() -> int:
    folder, program, *arguments = Path(sys.argv[1]), *sys.argv[2:]
    if program == "sbatch":
        return sbatch(folder, arguments)
    if program == "squeue":
        return squeue(folder)
    if program == "scancel":
        return scancel(folder, int(arguments[0]))
    return run(folder, int(arguments[0]), json.loads(arguments[1]))


if __name__ == "__main__":
    sys.exit(main())
