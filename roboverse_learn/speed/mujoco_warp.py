"""``simulator=mujoco_warp`` against bare ``mujoco_warp`` on the same envs: ``roboverse speed mujoco_warp``.

On a GPU both replay CUDA graphs, physics with 8,192 envs and images with 1,024. On a CPU a few envs show
that the program works.
"""

import dataclasses
import sys
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program, repeat

TASK = "PickCube"
GOAL, SIMPLIFIED_GOAL = 0.9, 2.0
IMAGE_SIZES = (128, 256)
_COPIED = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class Scale:
    """Sizes and repetitions of a measurement."""

    physics_envs: int  # envs that are stepped
    control_steps: int  # control steps of one turn
    render_envs: int  # envs that are rendered
    images: int  # images of each env in one turn
    turns: int  # how often each side is timed


GPU = Scale(physics_envs=8192, control_steps=20, render_envs=1024, images=5, turns=5)
CPU = Scale(physics_envs=8, control_steps=2, render_envs=4, images=1, turns=3)


@dataclasses.dataclass(frozen=True, kw_only=True, slots=True)
class WarpSettings(Settings):
    """Compares our handler to bare mujoco_warp.

    Attributes:
        parts: physics, render_128, render_256, unsimplified_128, unsimplified_256 (the bare tracer renders
            the robot's own meshes, ours are simplified).
        device: ``auto``, ``cpu``, ``cuda``, ``cuda:1``.
        physics_envs: Envs that are stepped; 0 takes what suits the device.
        render_envs: Envs that are rendered; 0 takes what suits the device.
        out: JSON file for the measurements.
    """

    device: str = "auto"
    physics_envs: int = 0
    render_envs: int = 0


def parts(settings: WarpSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    from envs.simulators.mujoco_warp.device import Device

    scale = GPU if Device(settings.device).is_cuda else CPU
    sizes = {key: getattr(settings, key) for key in ("physics_envs", "render_envs")}
    scale = dataclasses.replace(scale, **{key: size for key, size in sizes.items() if size})
    found = {"physics": partial(measure_physics, scale, settings.device)}
    for name, simplified in (("render", True), ("unsimplified", False)):
        for size in IMAGE_SIZES:
            measure = partial(measure_render, scale, size, settings.device, simplified=simplified)
            found[f"{name}_{size}"] = measure
    return found


def measure_physics(scale: Scale, device: str = "auto") -> Measurement:
    """Compares control steps (targets in, states out) to as many bare ``mujoco_warp.step``.

    Args:
        scale: How much.
        device: Torch device, or ``auto``.

    Returns:
        Seconds per physics step of all envs.

    Raises:
        SimulatorError: The two did not end in the same state.
    """
    import mujoco_warp as mjw

    handler, scenario = make_handler(scale.physics_envs, device)
    on = handler.on
    model, data = put_physics(handler)
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

    def check() -> None:
        gap = (handler.views.qpos - views["qpos"]).abs().mean().item()
        if not gap < 1e-2:
            raise SimulatorError(
                f"The joints ended {gap:.2g} apart on average: this is not the same physics."
            )

    seconds = in_turns(ours, bare, scale.turns, before=begin, after=check, wait=on.synchronize)
    handler.close()
    name = f"physics of {TASK}, {scale.physics_envs} envs on {on.torch}, bare mujoco_warp / ours"
    return measurement(name, seconds, Goal(GOAL, applies=on.is_cuda), units=decimation * scale.control_steps)


def measure_render(
    scale: Scale, image_size: int, device: str = "auto", *, simplified: bool = True
) -> Measurement:
    """Compares RGB images as torch tensors to the bare tracer, which leaves packed pixels in its buffer.

    Ours includes the poses of the bodies, the appearance of each env, and unpacking; both render one camera.

    Args:
        scale: How much.
        image_size: Pixels a side.
        device: Torch device, or ``auto``.
        simplified: Whether the bare tracer renders our simplified meshes too, or the robot's own.

    Returns:
        Seconds per image of all envs.
    """
    import mujoco_warp as mjw

    from envs.mjcf.model import build_model
    from envs.simulators.mujoco.render import Stage
    from envs.simulators.mujoco.render_warp import create_context, ready_for_tracing

    handler, scenario = make_handler(scale.render_envs, device, image_size)
    on, cameras = handler.on, tuple(camera.name for camera in scenario.cameras)
    stage = Stage(handler.model if simplified else build_model(scenario, simplify=False), scenario)
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

    bare = on.capture(trace).launch if on.is_cuda else trace
    with on.scope():
        ours, theirs = (repeat(call, scale.images) for call in (handler.render_tensors, bare))
        seconds = in_turns(ours, theirs, scale.turns, wait=on.synchronize)
    handler.close()
    name = (
        f"RGB {image_size}×{image_size}, {scale.render_envs} envs on {on.torch}, "
        f"bare mujoco_warp.render{'' if simplified else ' of unsimplified meshes'} / ours"
    )
    goal = Goal(GOAL if simplified else SIMPLIFIED_GOAL, applies=on.is_cuda)
    return measurement(name, seconds, goal, units=scale.images)


def make_handler(num_envs: int, device: str, image_size: int | None = None) -> tuple[Any, Any]:
    """Returns a launched handler at the task's initial states, and its scenario with one camera."""
    from envs.simulators import HANDLERS
    from envs.tasks import TASKS

    task = TASKS.get(TASK)()
    scenario = task.scenario
    size = {} if image_size is None else {"width": image_size, "height": image_size}
    camera = dataclasses.replace(scenario.cameras[0], **size)
    scenario = dataclasses.replace(
        scenario, cameras=(camera,), simulators={"mujoco_warp": {"device": device}}
    )
    build: Any = HANDLERS.get("mujoco_warp")
    handler = build(scenario, num_envs)
    handler.launch()
    handler.set_states(task.initial_state([np.random.default_rng(index) for index in range(num_envs)]))
    return handler, scenario


def put_physics(handler: Any) -> tuple[Any, Any]:
    """Returns the model of a handler and empty data, for bare mujoco_warp on the handler's device."""
    import mujoco_warp as mjw

    settings, model = handler.settings, handler.physics_model
    with handler.on.scope():
        warp_model = mjw.put_model(model)
        warp_model.opt.warn_overflow = 0
        data = mjw.make_data(model, nworld=handler.num_envs, nconmax=settings.nconmax, njmax=settings.njmax)
    return warp_model, data


if __name__ == "__main__":
    sys.exit(program("mujoco_warp", WarpSettings, parts))
