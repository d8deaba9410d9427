"""Environments shared out among processes: for simulators that one process can step only one by one.

Each process holds a part of the environments behind the inner handler. States lie in shared memory: a
process writes its rows after whatever changed them, so that reading states asks nobody. Commands and
pictures go through pipes.

Processes are forked from one that has imported what they need and done nothing else (``forkserver``); it ends
with the program. They see the environment variables, the path and the folder of the moment when they are
started; only what libraries read while they are imported, such as ``OMP_NUM_THREADS``, is that of the first
start. A script that makes one of these handlers needs the usual ``if __name__ == "__main__":``.
"""

import itertools
import multiprocessing
import os
import sys
import weakref
from collections.abc import Mapping, Sequence
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext, SpawnContext
from typing import Any, override

import numpy as np
import torch
from torch import Tensor

from envs.core.errors import ConfigError, RoboVerseError, SimulatorError, unknown_name
from envs.scenario import Appearance, ScenarioCfg
from envs.simulators import HANDLERS
from envs.simulators.base import EnvIds, Handler, TextureSource
from envs.simulators.workers import SharedState, Worker
from envs.state import State

_PRELOADED = ["envs.simulators.workers", "envs.simulators.mujoco.handler", "mujoco_warp"]
"""The default simulator and renderer. None touches a GPU, and OpenBLAS ends its threads before a fork."""


class ProcessHandler(Handler):
    """N environments of another handler, in processes.

    Args:
        scenario: The scene.
        num_envs: Number of environments.
        simulator: Name of the simulator inside each process.
        num_processes: How many; 0 means one per core, and never more than there are environments.
        renderer: Name of a renderer, or None for the simulator's default.
        num_threads: Threads of each process; 0 means one.
        textures: Gives the pictures of the named materials; a function of a module, or a method of
            something that can be copied to another process.
    """

    def __init__(
        self,
        scenario: ScenarioCfg,
        num_envs: int,
        *,
        simulator: str = "mujoco",
        num_processes: int = 0,
        renderer: str | None = None,
        num_threads: int = 0,
        textures: TextureSource | None = None,
    ) -> None:
        super().__init__(
            scenario, num_envs, renderer=renderer or "", num_threads=num_threads, textures=textures
        )
        if num_processes < 0:
            raise ConfigError(f"num_processes is 1 or more, or 0 for one per core; given {num_processes}.")
        self.simulator = simulator
        self.dtype = HANDLERS.get(simulator).dtype
        count = min(num_processes or os.cpu_count() or 1, num_envs)
        self.num_processes = count
        self._bounds = [round(num_envs * index / count) for index in range(count + 1)]
        self._workers: list[Worker] = []
        self._shared: SharedState | None = None
        self._known: dict[str, Any] = {}

    @override
    def launch(self) -> None:
        options: dict[str, Any] = {"num_threads": self.num_threads or 1, "textures": self.textures}
        if self.renderer_name:
            options["renderer"] = self.renderer_name
        context = _context()
        try:
            for low, high in itertools.pairwise(self._bounds):
                job = (self.simulator, self.scenario, high - low, options)
                self._workers.append(Worker(context, job, low, high))
            layouts = [worker.reply() for worker in self._workers]
            self._shared = SharedState.create(layouts[0], self.num_envs)
            for worker in self._workers:
                worker.send("share", self._shared.name, self._shared.layout, self.num_envs, worker.low)
            for worker in self._workers:
                worker.reply()
        except BaseException:
            self.close()
            raise
        self._finalizer = weakref.finalize(self, _stop, self._workers, self._shared)

    def _ask(self, command: str, env_ids: EnvIds, *arguments: Any, split: Sequence[Any] = ()) -> list[Any]:
        """Sends a command to every process of these environments, and waits for all of them.

        Args:
            command: Method of :class:`envs.simulators.workers.Inside`.
            env_ids: Environments.
            arguments: The same for every process.
            split: Values with one row per environment, of which each process gets its own.

        Returns:
            What they answered, in the order of the environments.
        """
        self._check_open()
        ids = np.arange(self.num_envs) if env_ids is None else np.asarray(env_ids)
        cuts = np.searchsorted(ids, self._bounds)
        asked = []
        for worker, (first, last) in zip(self._workers, itertools.pairwise(cuts.tolist()), strict=True):
            if last > first:
                own = (_rows(value, first, last) for value in split)
                worker.send(command, (ids[first:last] - worker.low).tolist(), *arguments, *own)
                asked.append(worker)
        return _gather(asked)

    # -- states -------------------------------------------------------------------------------------

    def _check_open(self) -> "SharedState":
        if self._shared is None:
            raise SimulatorError(
                "The simulator does not run: call launch() first, and nothing after close()."
            )
        return self._shared

    @override
    def get_states(self, env_ids: EnvIds = None) -> State:
        rows = slice(None) if env_ids is None else np.asarray(env_ids)
        return State.unflatten(
            {key: torch.from_numpy(array[rows].copy()) for key, array in self._check_open().arrays.items()}
        )

    @override
    def set_states(self, states: State, env_ids: EnvIds = None) -> None:
        self._check_open()
        known = [item.name for item in (*self.scenario.robots, *self.scenario.objects)]
        for name in states.entities():
            if name not in known:
                raise unknown_name("robot or object", name, known)
        flat = {key: value.cpu().numpy() for key, value in states.flatten().items()}
        self._ask("set_states", env_ids, split=(flat,))

    @override
    def set_poses(self, poses: Mapping[str, tuple[Tensor, Tensor]], env_ids: EnvIds = None) -> None:
        flat = {name: (np.asarray(pos), np.asarray(rot)) for name, (pos, rot) in poses.items()}
        ids = np.arange(self.num_envs) if env_ids is None else np.asarray(env_ids)
        whole = {
            name: tuple(np.broadcast_to(part, (len(ids), part.shape[-1])) for part in pair)
            for name, pair in flat.items()
        }
        self._ask("set_poses", ids, split=(whole,))

    @override
    def set_joint_targets(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds = None) -> None:
        self._ask("set_joint_targets", env_ids, split=(self._whole(targets, env_ids),))

    def _whole(self, targets: Mapping[str, Tensor | np.ndarray], env_ids: EnvIds) -> dict[str, np.ndarray]:
        count = self.num_envs if env_ids is None else len(env_ids)
        arrays = {name: np.asarray(target) for name, target in targets.items()}
        return {name: np.broadcast_to(a, (count, a.shape[-1])) for name, a in arrays.items()}

    # -- time ---------------------------------------------------------------------------------------

    @override
    def step(self, num_steps: int, env_ids: EnvIds = None) -> None:
        self._ask("step", env_ids, num_steps)

    @override
    def step_towards(
        self, targets: Mapping[str, Tensor | np.ndarray], num_steps: int, env_ids: EnvIds = None
    ) -> None:
        self._ask("step_towards", env_ids, num_steps, split=(self._whole(targets, env_ids),))

    # -- pictures -----------------------------------------------------------------------------------

    @override
    def set_appearance(self, appearance: Appearance, env_id: int) -> None:
        self._ask("set_appearance", [env_id], appearance)

    @override
    def snapshot(self, env_ids: EnvIds = None) -> list[Any]:
        return [job for jobs in self._ask("snapshot", env_ids) for job in jobs]

    @override
    def render(
        self,
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
        env_ids: EnvIds = None,
    ) -> dict[str, dict[str, np.ndarray]]:
        names, modalities = self.checked_names(cameras, modalities)
        return _joined(self._ask("render", env_ids, names, tuple(modalities)))

    @override
    def render_jobs(
        self,
        jobs: Sequence[Any],
        cameras: Sequence[str] | None = None,
        modalities: Sequence[str] = ("rgb",),
    ) -> dict[str, dict[str, np.ndarray]]:
        names, modalities = self.checked_names(cameras, modalities)
        cuts = [round(len(jobs) * index / self.num_processes) for index in range(self.num_processes + 1)]
        asked = []
        self._check_open()
        for worker, (first, last) in zip(self._workers, itertools.pairwise(cuts), strict=True):
            if last > first or worker is self._workers[0]:
                worker.send("render_jobs", list(jobs[first:last]), names, tuple(modalities))
                asked.append(worker)
        return _joined(_gather(asked))

    def _fact(self, name: str) -> Any:
        if name not in self._known:
            self._known[name] = self._ask("fact", [0], name)[0]
        return self._known[name]

    @property
    @override
    def segmentation_names(self) -> tuple[str, ...]:
        return self._fact("segmentation_names")

    @property
    @override
    def not_shown(self) -> tuple[str, ...]:
        return self._fact("not_shown")

    @override
    def close(self) -> None:
        workers, self._workers = self._workers, []
        shared, self._shared = self._shared, None
        _stop(workers, shared)


def _context() -> ForkServerContext | SpawnContext:
    """Returns what starts processes, with the server that they are forked from running.

    Python 3.12 does not tell a server our ``sys.path``: it would import another ``envs`` that lies in the
    current folder. A process that was itself forked has no server to ask, and starts its own afresh.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_PRELOADED)
    ours = dict(os.environ)
    path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
    try:
        os.environ.update(PYTHONPATH=path, PYTHONSAFEPATH="1")
        forkserver.ensure_running()
    except ChildProcessError:
        return multiprocessing.get_context("spawn")
    finally:
        for name in ("PYTHONPATH", "PYTHONSAFEPATH"):
            os.environ.pop(name)
        os.environ.update(ours)
    return context


def _rows(value: Any, first: int, last: int) -> Any:
    if isinstance(value, dict):
        return {key: _rows(item, first, last) for key, item in value.items()}
    if isinstance(value, tuple):
        return tuple(_rows(item, first, last) for item in value)
    return value[first:last]


def _joined(parts: list[dict[str, dict[str, np.ndarray]]]) -> dict[str, dict[str, np.ndarray]]:
    return {
        camera: {kind: np.concatenate([part[camera][kind] for part in parts]) for kind in kinds}
        for camera, kinds in parts[0].items()
    }


def _gather(asked: "Sequence[Worker]") -> list[Any]:
    """Takes every answer before it raises the first error, so that no answer is left in a pipe."""
    replies, errors = [], []
    for worker in asked:
        try:
            replies.append(worker.reply())
        except RoboVerseError as error:
            errors.append(error)
    if errors:
        raise errors[0]
    return replies


def _stop(workers: "list[Worker]", shared: "SharedState | None") -> None:
    for worker in workers:
        worker.stop()
    workers.clear()
    if shared is not None:
        shared.free()
