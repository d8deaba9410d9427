"""Calls that one operating system has and another has not stand behind a check that the system has them."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("envs", "policies", "benchmark", "roboverse_learn")
SOURCES = sorted(path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))

MODULES = {"fcntl", "resource", "pwd", "grp", "termios", "tty", "pty", "posix", "syslog", "msvcrt", "winreg"}
CALLS = {
    "os": {
        *("fork", "forkpty", "sched_getaffinity", "sched_setaffinity", "sysconf", "posix_fallocate", "pread"),
        *("pwrite", "getuid", "geteuid", "getgid", "killpg", "getpgid", "setpgid", "setsid", "uname", "nice"),
        *(
            "getloadavg",
            "mkfifo",
            "statvfs",
            "fchmod",
            "fchown",
            "chown",
            "sendfile",
            "wait",
            "wait3",
            "wait4",
        ),
        *("waitpid", "WNOHANG", "O_DIRECTORY", "O_NOFOLLOW", "O_CLOEXEC", "O_DIRECT", "memfd_create", "sync"),
        *("sched_getscheduler", "sched_setscheduler", "sched_getparam", "sched_setparam", "sched_param"),
        *("startfile", "O_BINARY", "copy_file_range", "fdatasync", "posix_fadvise", "pipe2"),
    },
    "signal": {
        *("SIGKILL", "SIGALRM", "SIGHUP", "SIGQUIT", "SIGCHLD", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGSTOP"),
        *("alarm", "setitimer", "pthread_sigmask", "pthread_kill", "sigwait", "set_wakeup_fd"),
    },
}
FOLDERS = ("/proc", "/sys", "/dev", "/etc", "/tmp", "/var", "/usr")
CONTEXTS = {"fork", "forkserver"}

MAY_HAVE_PROBLEMS = re.compile(
    "|".join(
        [rf"\b(?:{'|'.join(sorted({*MODULES, *CALLS}))})\b", "get_context", "set_start_method", *FOLDERS]
    )
)
"""Found in every source that has a problem; parsing the others would only take time."""


def problems(source: str) -> list[tuple[int, str]]:
    """Returns (line, what) of every call outside a guard.

    A guard is an ``if`` or a conditional expression that asks ``hasattr``, ``os.name`` or ``sys.platform``, a
    ``try`` that catches ``ImportError``, or, for a path, a question in the same function whether it exists.
    """
    found: list[tuple[int, str]] = []
    if not MAY_HAVE_PROBLEMS.search(source):
        return found

    def visit(node: ast.AST, guarded: bool, asks: bool) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            asks = any(
                isinstance(n, ast.Attribute) and n.attr in {"exists", "is_file"} for n in ast.walk(node)
            )
        if not guarded and (what := _of_one_system(node, asks)):
            found.append((getattr(node, "lineno", 0), what))
        for field, value in ast.iter_fields(node):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    visit(child, guarded or (field in {"body", "orelse"} and _is_guard(node)), asks)

    visit(ast.parse(source), False, False)
    return found


def _is_guard(node: ast.AST) -> bool:
    if isinstance(node, ast.Try):
        return any("ImportError" in ast.unparse(each.type) for each in node.handlers if each.type)
    if not isinstance(node, ast.If | ast.IfExp):
        return False
    test = ast.unparse(node.test)
    return any(word in test for word in ("hasattr(os,", "hasattr(signal,", "os.name", "sys.platform"))


def _of_one_system(node: ast.AST, asks: bool) -> str:
    """Returns what of a node not every system has, or an empty string."""
    if isinstance(node, ast.Import):
        return next((alias.name for alias in node.names if alias.name in MODULES), "")
    if isinstance(node, ast.ImportFrom):
        names = CALLS.get(node.module or "", set())
        return next((alias.name for alias in node.names if alias.name in names or node.module in MODULES), "")
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}" if node.attr in CALLS.get(node.value.id, set()) else ""
    if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("get_context", "set_start_method")):
        values = [*node.args, *(keyword.value for keyword in node.keywords)]
        words = [value.value for value in values if isinstance(value, ast.Constant)]
        return next((f"the start method '{word}'" for word in words if word in CONTEXTS), "")
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and not asks:
        return node.value if any(node.value == f or node.value.startswith(f"{f}/") for f in FOLDERS) else ""
    return ""


def test_calls_of_one_operating_system_are_guarded() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {what}"
        for path in SOURCES
        for line, what in problems(path.read_text(encoding="utf-8"))
    ]
    assert not found, "Guard these, or use psutil or filelock:\n" + "\n".join(found)


def test_cores_are_counted_that_this_process_may_use() -> None:
    """A container's share of a machine of 200 cores may be 16: 200 threads there are slower than two."""
    counts = re.compile(r"cpu_count\(\)|ThreadPoolExecutor\((None)?\)|PoolExecutor\([^)]*\bor None\b")
    may = {"envs/core/machine.py", "roboverse_learn/doctor.py"}
    found = {path for path in SOURCES if counts.search(path.read_text(encoding="utf-8"))}
    found = {path.relative_to(ROOT).as_posix() for path in found}
    assert found == may, "Take envs.core.machine.num_cores()."


@pytest.mark.parametrize(
    "source",
    [
        "import fcntl",
        "from os import fork",
        "import os\ndef f():\n    return len(os.sched_getaffinity(0))",
        "import os, sys\nif len(sys.argv) > 1:\n    os.sysconf('SC_PAGE_SIZE')",
        "import os, signal\nos.kill(1, signal.SIGKILL)",
        "open('/proc/meminfo').read()",
        "from multiprocessing import get_context\nget_context('fork')",
        "import multiprocessing\nmultiprocessing.set_start_method(method='forkserver')",
        "import os\nif hasattr(os, 'fork'):\n    pass\nos.fork()",
    ],
)
def test_an_unguarded_call_is_found(source: str) -> None:
    assert len(problems(source)) == 1


@pytest.mark.parametrize(
    "source",
    [
        "import os\nn = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()",
        "import signal\nif hasattr(signal, 'SIGUSR1'):\n    signal.signal(signal.SIGUSR1, print)",
        "import sys\nif sys.platform == 'linux':\n    import fcntl",
        "try:\n    import resource\nexcept ImportError:\n    resource = None",
        "def f():\n    p = Path('/proc/cpuinfo')\n    return p.exists() and p.read_text()",
        "from multiprocessing import get_context\nget_context('spawn')",
    ],
)
def test_a_guarded_call_is_not_found(source: str) -> None:
    assert problems(source) == []
