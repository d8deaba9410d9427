"""Programs in processes that begin with the libraries imported, which takes longer than most of them.

Python's fork server imports once and forks them all. It imports none of our modules: a program finds plugins
and entry points as it does when a user starts it.
"""

import multiprocessing
import os
import runpy
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMMAND = ROOT / "roboverse_learn/__main__.py"

FIND_TESTS = f"""
import sys, types
sys.path.insert(0, {str(ROOT)!r})
sys.modules["tests"] = types.ModuleType("tests")  # another distribution's may be installed
sys.modules["tests"].__path__ = [{str(ROOT / "tests")!r}]
"""
"""The beginning of a program that imports from ``tests``."""

CONTEXT = multiprocessing.get_context("forkserver")
CONTEXT.set_forkserver_preload(
    [
        *("torch", "torch.utils.tensorboard", "torch._dynamo", "torch._inductor.config", "accelerate"),
        *("lerobot.policies.factory", "lerobot.policies.act.modeling_act"),
        *("lerobot.datasets.lerobot_dataset", "datasets", "pyarrow.parquet", "av", "gymnasium"),
        *("mujoco_warp", "mink", "scipy.stats", "trimesh", "matplotlib.pyplot"),
        *("hydra", "pydantic", "jinja2", "jsonschema_rs", "rich.live", "rich.progress"),
    ]
)


def start(
    program: str | Path,
    *words: str,
    folder: Path,
    out: Path,
    err: Path | None = None,
    env: Mapping[str, str] | None = None,
) -> BaseProcess:
    """Starts a program; ``join``, ``exitcode`` and ``kill`` are those of ``multiprocessing``.

    Args:
        program: A Python file, or the text of a program.
        words: Its command line.
        folder: The folder it runs in.
        out: A file for what it prints.
        err: A file for its errors, or None for the same.
        env: Environment variables, or None for those of this process; ``PYTHONPATH`` is heeded.
    """
    given = {"program": program, "words": words, "folder": folder, "out": out, "err": err}
    given["env"] = dict(os.environ if env is None else env)
    script = str(Path(__file__).with_name("started_program.py"))
    process = CONTEXT.Process(target=runpy.run_path, args=(script, {"start": given}))
    process.start()
    return process


def run(
    program: str | Path, *words: str, folder: Path | None = None, env: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Runs a program to its end, as ``subprocess.run`` does with ``capture_output``."""
    with tempfile.TemporaryDirectory() as made:
        out, err = Path(made) / "out", Path(made) / "err"
        process = start(program, *words, folder=folder or Path.cwd(), out=out, err=err, env=env)
        process.join()
        code = process.exitcode
        process.close()
        assert code is not None
        return subprocess.CompletedProcess([str(program), *words], code, out.read_text(), err.read_text())


def installed(command: str) -> Path:
    """Returns the file of a command that an installer made, such as ``lerobot-train``."""
    return Path(sys.executable).with_name(command)


def wait_for_all(processes: Sequence[BaseProcess], timeout_s: float) -> list[int | None]:
    """Waits for processes; returns their exit codes, None where one still runs."""
    for process in processes:
        process.join(timeout_s)
    return [process.exitcode for process in processes]
