"""MuJoCo Warp behind our interface, against bare ``mujoco_warp`` on the same worlds, in one process.

On a GPU both replay CUDA graphs, physics with 8,192 worlds and pictures with 1,024. On a CPU a few worlds
show that the program works; a CPU is not what either is for.
"""

import dataclasses
import logging
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import numpy as np

from envs.core.arguments import run_program
from envs.core.errors import SimulatorError
from roboverse_learn.speed.throughput import Measurement

log = logging.getLogger(__name__)

TASK = "PickCube"
GOAL = 0.9
SIMPLIFIED_GOAL = 2.0
IMAGE_SIZES = (128, 256)


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """How much is measured.

    Attributes:
        physics_worlds: Worlds that are stepped.
        control_steps: Control steps of one turn.
        render_worlds: Worlds that are drawn.
        pictures: Pictures of each world in one turn.
        turns: How often either side is timed, after one turn that warms up.
    """

    physics_worlds: int
    control_steps: int
    render_worlds: int
    pictures: int
    turns: int


GPU = Scale(physics_worlds=8192, control_steps=20, render_worlds=1024, pictures=5, turns=5)
CPU = Scale(physics_worlds=8, control_steps=2, render_worlds=4, pictures=1, turns=3)


def measure_physics(scale: Scale, device: str = "auto") -> Measurement:
    """Compares control steps (targets in, states out) to the same number of bare ``mujoco_warp.step``.

    Returns:
        Seconds per physics step of all worlds; the ratio is the bare time over ours.

    Raises:
        SimulatorError: The two did not end in the same state, so it was not the same physics.
    """
    import mujoco_warp as mjw

    handler, scenario = make_handler(scale.physics_worlds, device)
    on, settings = handler.on, handler.settings
    with on.scope():
        model = mjw.put_model(handler.physics_model)
        model.opt.warn_overflow = 0
        data = mjw.make_data(
            handler.physics_model, nworld=handler.num_envs, nconmax=settings.nconmax, njmax=settings.njmax
        )
    step = on.capture(lambda: mjw.step(model, data))
    views = {name: on.tensor(getattr(data, name)) for name in _COPIED}
    robot, decimation = scenario.robots[0].name, scenario.physics.decimation
    start = handler.get_states()
    targets = [
        start.robots[robot].joint_pos + 0.05 * np.sin(0.3 * index) for index in range(scale.control_steps)
    ]

    def begin() -> None:
        handler.set_states(start)
        for name, view in views.items():
            view.copy_(getattr(handler.views, name)) if name != "qacc_warmstart" else view.zero_()

    def ours() -> None:
        for target in targets:
            handler.set_joint_targets({robot: target}, None)
            handler.step(decimation)
            handler.get_states()

    def bare() -> None:
        for target in targets:
            views["ctrl"].copy_(target)
            step.launch(decimation)

    times = [_in_turns(ours, bare, begin, on.synchronize, turn) for turn in range(scale.turns + 1)][1:]
    away = (handler.views.qpos - views["qpos"]).abs().mean().item()
    if not away < 1e-2:
        raise SimulatorError(f"The joints ended {away:.2g} apart on average: this is not the same physics.")
    handler.close()
    steps = decimation * scale.control_steps
    name = f"physics of {TASK}, {scale.physics_worlds} worlds on {on.torch}, bare mujoco_warp / ours"
    return _measurement(name, np.array(times) / steps)


_COPIED = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")


def measure_render(
    scale: Scale, image_size: int, device: str = "auto", *, simplified: bool = True
) -> Measurement:
    """Compares RGB pictures as torch tensors to the bare tracer, which leaves packed pixels in its buffer.

    Ours includes posing the bodies, the looks of each world, and unpacking; both draw one camera.

    Args:
        scale: How much.
        image_size: Pixels a side.
        device: Torch device, or ``auto``.
        simplified: Whether the bare tracer draws our simplified meshes too, or the robot's own.

    Returns:
        Seconds per picture of all worlds; the ratio is the bare time over ours.
    """
    import mujoco_warp as mjw

    from envs.mjcf.model import build_model
    from envs.simulators.mujoco.render import Stage
    from envs.simulators.mujoco.render_warp import create_context, ready_for_tracing

    handler, scenario = make_handler(scale.render_worlds, device, image_size)
    on, cameras = handler.on, tuple(camera.name for camera in scenario.cameras)
    drawn = handler.model if simplified else build_model(scenario, simplify=False)
    stage = Stage(drawn, scenario)
    ready_for_tracing(stage.model)
    stage.dress(scenario.appearance)
    with on.scope():
        model = mjw.put_model(stage.model)
        data = mjw.make_data(stage.model, nworld=handler.num_envs, nconmax=1, njmax=1)
        for name in ("qpos", "mocap_pos", "mocap_quat"):
            on.tensor(getattr(data, name)).copy_(getattr(handler.views, name))
        mjw.kinematics(model, data)
        mjw.camlight(model, data)
        context = create_context(stage.model, cameras, ("rgb",), num_worlds=handler.num_envs)

    def trace() -> None:
        mjw.refit_bvh(model, data, context)
        mjw.render(model, data, context)

    def bare() -> None:
        for _ in range(scale.pictures):
            graph.launch() if graph is not None else trace()

    def ours() -> None:
        for _ in range(scale.pictures):
            handler.render_tensors()

    graph = on.capture(trace) if on.is_cuda else None
    with on.scope():
        times = [_in_turns(ours, bare, lambda: None, on.synchronize, t) for t in range(scale.turns + 1)][1:]
    handler.close()
    name = (
        f"RGB {image_size}×{image_size}, {scale.render_worlds} worlds on {on.torch}, "
        f"bare mujoco_warp.render{'' if simplified else ' of unsimplified meshes'} / ours"
    )
    goal = GOAL if simplified else SIMPLIFIED_GOAL
    return _measurement(name, np.array(times) / scale.pictures, goal)


def make_handler(num_envs: int, device: str, image_size: int | None = None) -> tuple[Any, Any]:
    """Returns a launched handler at the task's initial states, and its scenario with one camera."""
    from envs.simulators import HANDLERS
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = task.scenario
    camera = dataclasses.replace(
        scenario.cameras[0], **({} if image_size is None else {"width": image_size, "height": image_size})
    )
    scenario = dataclasses.replace(
        scenario, cameras=(camera,), simulators={"mujoco_warp": {"device": device}}
    )
    build: Any = HANDLERS.get("mujoco_warp")
    handler = build(scenario, num_envs)
    handler.launch()
    handler.set_states(task.initial_state([np.random.default_rng(index) for index in range(num_envs)]))
    return handler, scenario


def _in_turns(
    ours: Callable[[], object],
    bare: Callable[[], object],
    begin: Callable[[], object],
    wait: Callable[[], object],
    turn: int,
) -> tuple[float, float]:
    """Times both from the same beginning, now the one first and now the other."""
    seconds = [0.0, 0.0]
    begin()
    for which in (turn % 2, 1 - turn % 2):
        wait()
        started = time.perf_counter()
        (ours, bare)[which]()
        wait()
        seconds[which] = time.perf_counter() - started
    return seconds[0], seconds[1]


def _measurement(name: str, times: np.ndarray, goal: float = GOAL) -> Measurement:
    ours, bare = times.T
    return Measurement(
        name=name,
        ours_s=median(ours),
        baseline_s=median(bare),
        ratio=median(bare / ours),
        goal=f"goal ≥ {goal:.2f} on a GPU",
    )


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class WarpBenchmark:
    """``python -m roboverse_learn.speed.mujoco_warp``: our handler against bare mujoco_warp.

    Attributes:
        device: ``auto``, ``cpu``, ``cuda``, ``cuda:1``.
        physics_worlds: Worlds that are stepped; 0 takes what suits the device.
        render_worlds: Worlds that are drawn; 0 takes what suits the device.
    """

    device: str = "auto"
    physics_worlds: int = 0
    render_worlds: int = 0


def main(words: Sequence[str] | None = None) -> int:
    """Logs every measurement; the exit code is 1 where a GPU misses a goal."""
    return run_program("python -m roboverse_learn.speed.mujoco_warp", WarpBenchmark, _measure_all, words)


def _measure_all(arguments: WarpBenchmark) -> int:
    from envs.simulators.mujoco_warp.device import Device

    logging.basicConfig(level=logging.WARNING, format="%(message)s", stream=sys.stdout)
    log.setLevel(logging.INFO)
    on_gpu = Device(arguments.device).is_cuda
    scale = GPU if on_gpu else CPU
    sizes = {key: getattr(arguments, key) for key in ("physics_worlds", "render_worlds")}
    scale = dataclasses.replace(scale, **{key: size for key, size in sizes.items() if size})
    physics = measure_physics(scale, arguments.device)
    log.info("%s", physics)
    missed = physics.ratio < GOAL
    for size in IMAGE_SIZES:
        for simplified, goal in ((True, GOAL), (False, SIMPLIFIED_GOAL)):
            measurement = measure_render(scale, size, arguments.device, simplified=simplified)
            log.info("%s", measurement)
            missed |= measurement.ratio < goal
    return int(on_gpu and missed)


if __name__ == "__main__":
    sys.exit(main())
