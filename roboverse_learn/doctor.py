"""``roboverse doctor``: the machine, the installation, and what works here; the content of a bug report.

Whatever may crash or hang (drivers, renderers, video libraries) runs in a process of its own. A part that
fails is reported with its reason, and the others still run.
"""

import sys
from pathlib import Path

if __name__ == "__main__":  # as a script: this folder's `data` must not hide other packages
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import importlib
import importlib.metadata
import json
import logging
import os
import platform
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

from envs.core.errors import RoboVerseError
from envs.core.extras import DISTRIBUTION, install_command
from envs.core.machine import num_cores
from envs.core.registry import leave_out_broken_plugins
from roboverse_learn.commands.verdict import verdict
from roboverse_learn.config.schema import DoctorConfig
from roboverse_learn.extras import missing_packages

type Facts = dict[str, Any]

log = logging.getLogger(__name__)

_PROBE_LIMIT_S = 120.0
_TIMED_S = 1.5
_LOOK_S = 0.5
_BUSY_PERCENT = 30.0
"""Share of the processor, taken by others, from which on the figures of speed say so."""

_IMAGE_SIZE = 64
_UNTIMED = "untimed"
"""Word for the check of a renderer that measures nothing."""

_TAKES = "This takes about a minute, several on a slow or busy machine; speed=false takes less than half."
_TAKES_UNTIMED = "This takes about half a minute, more on a slow or busy machine."

_FEATURES = ("avx2", "avx512_f", "avx512_vnni", "avx512_bf16", "amx_bf16", "sve")
_GIB = 1 << 30


def doctor(config: DoctorConfig) -> str:
    """Returns the report as text for people, which ends with a verdict, or as JSON."""
    report = diagnose(timed=config.speed)
    return json.dumps(report, indent=1) if config.json else f"{as_text(report)}\n\n{verdict(report)}"


def diagnose(*, timed: bool = True) -> dict[str, Facts]:
    """Returns the facts of every part; a part that fails has its reason under ``failed``.

    Args:
        timed: Also measure speeds.
    """
    parts = PARTS if timed else {name: part for name, part in PARTS.items() if name != "speed"}
    if "renderers" in parts:
        log.info(_TAKES if timed else _TAKES_UNTIMED)
    untimed = {} if timed else {"renderers": partial(renderers, timed=False)}
    return {name: _guarded(untimed.get(name, part)) for name, part in parts.items()}


def as_text(report: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns a report with one fact a line."""
    lines = []
    for part, facts in report.items():
        width = max(map(len, facts), default=0)
        lines += [f"{part.capitalize()}:", *(f"  {key:<{width}}  {_shown(facts[key])}" for key in facts), ""]
    return "\n".join(lines).rstrip()


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_shown(item)}" for key, item in value.items())
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return f"{value:,g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def _guarded(part: Callable[[], Facts]) -> Facts:
    try:
        return part()
    except Exception as error:  # whatever it is, the other parts are still wanted
        return {"failed": _reason(error)}


def _reason(error: BaseException) -> str:
    """Returns an error in one line."""
    text = " ".join(str(error).split())
    text = text if len(text) <= 400 else f"{text[:400]}…"
    return text if isinstance(error, RoboVerseError) and text else f"{type(error).__name__}: {text}"


def system() -> Facts:
    """Python, operating system, processor and memory."""
    import psutil

    memory = psutil.virtual_memory()
    return {
        "python": f"{platform.python_version()} ({sys.executable})",
        "os": platform.platform(),
        "cpu": _cpu_model(),
        "cores": f"{num_cores()} usable of {os.cpu_count()}",
        "memory": f"{memory.total / _GIB:.1f} GiB, {memory.available / _GIB:.1f} GiB available",
    }


def _cpu_model() -> str:
    info = Path("/proc/cpuinfo")
    found = re.search(r"model name\s*: (.+)", info.read_text(encoding="utf-8")) if info.exists() else None
    return found[1] if found else platform.processor() or platform.machine()


def packages() -> Facts:
    """Versions of the packages that decide the outcome of an episode, and the commit of a checkout."""
    from benchmark.provenance import git_state, package_versions

    git = git_state()
    commit = {} if git is None else {"commit": f"{git.sha}{', changed' if git.dirty else ''}"}
    return {name: text for name, text in package_versions().items() if name != "python"} | commit


def extras() -> Facts:
    """Every optional extra: installed, or how to install it."""
    found: Facts = {}
    for extra in importlib.metadata.metadata(DISTRIBUTION).get_all("Provides-Extra") or ():
        missing = missing_packages(extra)
        found[extra] = f"without {', '.join(missing)}; {install_command(extra)}" if missing else "installed"
    return found


def plugins() -> Facts:
    """What other installed packages register, plugins that fail, and every name that is registered twice."""
    broken = leave_out_broken_plugins()
    found: Facts = {}
    twice: list[str] = []
    for place in _REGISTRIES:
        module, _, name = place.partition(":")
        registry = getattr(importlib.import_module(module), name)
        for entry in map(registry.entry, registry):
            for each in filter(lambda owner: owner.distribution, (entry, *entry.rivals)):
                found.setdefault(each.distribution, []).append(f"{registry.kind} {each.name}")
        twice += registry.conflicts()
    problems = {"cannot be imported": " ".join(broken.values()), "registered twice": " ".join(twice)}
    return (found or {"packages": "none"}) | {what: said for what, said in problems.items() if said}


_REGISTRIES = (
    *("envs.tasks:TASKS", "envs.tasks.suites:SUITES", "envs.tasks.protocols:PROTOCOLS"),
    *("envs.robots:ROBOTS", "envs.randomization.channels:CHANNELS", "envs.randomization.levels:NAMED_LEVELS"),
    *("policies:POLICIES", "envs.core.assets:ASSETS", "roboverse_learn.data.sources:SOURCES"),
    "roboverse_learn.launch:LAUNCHERS",
)
"""Registries to which other packages add."""


def disk() -> Facts:
    """Free space where runs are written and where temporary files are."""
    folders = {"working folder": Path.cwd(), "temporary files": Path(tempfile.gettempdir())}
    return {name: f"{shutil.disk_usage(path).free / _GIB:.1f} GiB free" for name, path in folders.items()}


def torch_and_gpu() -> Facts:
    """GPUs, driver and CUDA, and the processor's features that torch uses."""
    return {"driver": _gpu_driver()} | _in_process("torch")


def _gpu_driver() -> str:
    program = shutil.which("nvidia-smi")
    if program is None:
        return "no nvidia-smi"
    command = [program, "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    return "; ".join(done.stdout.split("\n")).strip("; ") or f"nvidia-smi fails: {done.stderr.strip()[:200]}"


def video() -> Facts:
    """Whether a video can be written, and read with each decoder."""
    return {"ffmpeg": shutil.which("ffmpeg") or "no such program; needed by torchcodec alone"} | _in_process(
        "video"
    )


def renderers(*, timed: bool = True) -> Facts:
    """Images per second of each renderer, or whether it renders one; or why it does not work."""
    from envs.simulators import RENDERERS

    how = () if timed else (_UNTIMED,)
    return {name: _guarded(lambda name=name: _in_process("render", name, *how)) for name in RENDERERS}


def speed() -> Facts:
    """Measures environment steps, and training of ``policy=act preset=quick``.

    On a machine that is busy the figures are low, and one that takes too long is no failure.
    """
    import psutil

    parts = {"env": "PickCube, states, one environment", "train": "act, preset=quick, device=auto"}
    percent = psutil.cpu_percent(interval=_LOOK_S)
    measured = {
        f"{kind} ({what})": _guarded(lambda kind=kind: _in_process(kind)) for kind, what in parts.items()
    }
    if percent < _BUSY_PERCENT:
        return measured
    for facts in measured.values():
        if facts.get("failed") == _too_slow():
            facts["slow"] = facts.pop("failed")
    note = f"other programs use {percent:.0f} % of the processor: run doctor again when they are done"
    return {"machine is busy": note} | measured


def _too_slow() -> str:
    return f"no answer within {_PROBE_LIMIT_S:g} s"


PARTS: dict[str, Callable[[], Facts]] = {
    "system": system,
    "packages": packages,
    "extras": extras,
    "plugins": plugins,
    "gpu": torch_and_gpu,
    "disk": disk,
    "video": video,
    "renderers": renderers,
    "speed": speed,
}
"""Parts of the report, in order."""


def _in_process(*words: str) -> Facts:
    """Says what it looks at, runs one of :data:`_PROBES` in a process of its own, and returns what it found.

    Raises:
        RoboVerseError: It crashed or took too long.
    """
    log.info("Looking at %s …", _LOOKS_AT[words[0]].format(*words[1:]))
    command = [sys.executable, "-m", "roboverse_learn.doctor", *words]
    path = os.pathsep.join(filter(None, (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path}
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_PROBE_LIMIT_S, check=False, env=environment
        )
    except subprocess.TimeoutExpired:
        raise RoboVerseError(_too_slow()) from None
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["it printed nothing"])[-1]
        raise RoboVerseError(f"the process ended with exit code {done.returncode}: {last[:300]}")
    return json.loads(done.stdout.splitlines()[-1])


def _probe_torch() -> Facts:
    import torch

    known = torch.cpu.get_capabilities()
    facts: Facts = {
        "torch": f"{torch.__version__}, kernels for {torch.backends.cpu.get_cpu_capability()}",
        "cpu features": [name for name in _FEATURES if known.get(name)],
        "cuda": torch.version.cuda or "torch was built without it",
    }
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    gpus = [torch.cuda.get_device_properties(index) for index in range(count)]
    return facts | {"gpus": [f"{gpu.name}, {gpu.total_memory / _GIB:.0f} GiB" for gpu in gpus]}


def _probe_video() -> Facts:
    import numpy as np

    from benchmark.videos import write_video

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "test.mp4"
        write_video(path, np.zeros((4, _IMAGE_SIZE, _IMAGE_SIZE, 3), np.uint8), 10.0)
        return {
            name: _guarded(lambda read=read: {"decodes": read(path)})
            for name, read in (("pyav", _read_with_pyav), ("torchcodec", _read_with_torchcodec))
        }


def _read_with_pyav(path: Path) -> str:
    import av

    with closing(av.open(str(path))) as container:
        return f"{sum(1 for _ in container.decode(video=0))} frames"


def _read_with_torchcodec(path: Path) -> str:
    from torchcodec.decoders import VideoDecoder  # pyright: ignore[reportMissingImports]

    return f"{len(VideoDecoder(str(path)))} frames"


def _probe_render(renderer: str, how: str = "") -> Facts:
    import envs

    env = envs.make_vec("PickCube", 1, renderer=renderer, image_size=_IMAGE_SIZE)
    env.reset(seed=0)
    image = env.image(0)
    if not image.any():
        raise RoboVerseError("the image is black")
    size = f"{_IMAGE_SIZE}×{_IMAGE_SIZE}"
    facts: Facts = {"renders": size}
    if how != _UNTIMED:
        facts = {f"{size} images/s": _per_second(lambda: env.image(0))}
    env.close()
    return facts


def _probe_env() -> Facts:
    import envs

    env = envs.make_vec("PickCube", 1, observation="state")
    env.reset(seed=0)
    action = env.action_space.sample()
    rate = _per_second(lambda: env.step(action))
    env.close()
    return {"steps/s": rate}


def _probe_train() -> Facts:
    from roboverse_learn.config.compose import compose
    from roboverse_learn.training.device import resolve_device
    from roboverse_learn.training.learners import learner_of

    config = compose("train", ["policy=act", "preset=quick"])
    device = resolve_device("auto")
    seconds = learner_of(config, device).estimate_s()
    samples = config.train.steps * config.train.batch_size
    return {"samples/s": round(samples / seconds, 1), "device": device}


def _per_second(call: Callable[[], object]) -> float:
    """Returns calls per second, after one that warms up."""
    call()
    started, calls = time.perf_counter(), 0
    while (seconds := time.perf_counter() - started) < _TIMED_S:
        call()
        calls += 1
    return round(calls / seconds, 1)


_PROBES: dict[str, Callable[..., Facts]] = {
    "torch": _probe_torch,
    "video": _probe_video,
    "render": _probe_render,
    "env": _probe_env,
    "train": _probe_train,
}
"""Checks that run in their own process, which writes its facts as the last line of its output."""

_LOOKS_AT = {
    "torch": "torch and GPUs",
    "video": "videos",
    "render": "the renderer {}",
    "env": "the speed of an environment",
    "train": "the speed of training",
}
"""What each of them looks at, said before it starts."""


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] in _PROBES:
        found = _guarded(lambda: _PROBES[sys.argv[1]](*sys.argv[2:]))
        sys.stdout.write(f"\n{json.dumps(found)}\n")
    else:
        from roboverse_learn.cli import script

        script("doctor")
