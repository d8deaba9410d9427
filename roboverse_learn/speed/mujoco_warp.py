"""``simulator=mujoco_warp`` against bare ``mujoco_warp`` on the same envs: ``roboverse speed mujoco_warp``.

On a GPU both replay CUDA graphs, physics with 8,192 envs and images with 1,024. On a CPU a few envs show
that the program works.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from roboverse_learn.speed.harness import DeviceProgram, Goal, Measurement, part, require_same_physics, scaled
from roboverse_learn.speed.simulators import TASK, controlled, launched

GOAL, SIMPLIFIED_GOAL = 0.9, 2.0
_COPIED = ("qpos", "qvel", "ctrl", "mocap_pos", "mocap_quat", "qacc_warmstart")


@dataclass(frozen=True, kw_only=True, slots=True)
class MujocoWarp(DeviceProgram):
    """Compares our handler to bare mujoco_warp.

    Attributes:
        parts: physics, render_128, render_256, unsimplified_128, unsimplified_256 (the bare tracer renders
            the robot's own meshes, ours are simplified).
        physics_envs: Envs that are stepped.
        control_steps: Control steps of one turn.
        render_envs: Envs that are rendered.
        images: Images of each env in one turn.
        turns: How often each side is timed.
    """

    physics_envs: int = scaled(gpu=8192, cpu=8)
    control_steps: int = scaled(gpu=20, cpu=2)
    render_envs: int = scaled(gpu=1024, cpu=4)
    images: int = scaled(gpu=5, cpu=1)
    turns: int = scaled(gpu=5, cpu=3)

    @part("physics")
    def physics(self) -> Measurement:
        """Compares control steps (targets in, states out) to as many bare ``mujoco_warp.step``.

        The seconds are those of a physics step of all envs; both must end in the same state.
        """
        import mujoco_warp as mjw

        handler = launched("mujoco_warp", self.physics_envs, settings={"device": self.device})
        on, decimation, robot = handler.on, handler.scenario.physics.decimation, handler.scenario.robots[0]
        model, data = put_physics(handler)
        step = on.capture(lambda: mjw.step(model, data))
        views = {name: on.tensor(getattr(data, name)) for name in _COPIED}
        states = handler.get_states()
        start = states.robots[robot.name].joint_pos
        targets = [start + 0.05 * np.sin(0.3 * index) for index in range(self.control_steps)]

        def begin() -> None:
            handler.set_states(states)
            for name, view in views.items():
                view.copy_(getattr(handler.views, name)) if name != "qacc_warmstart" else view.zero_()

        def bare() -> None:
            for target in targets:
                views["ctrl"].copy_(target)
                step.launch(decimation)

        def check() -> None:  # of the average: on a GPU contacts are found in any order
            require_same_physics((handler.views.qpos - views["qpos"]).abs().mean().item(), 1e-2)

        name = f"physics of {TASK}, {self.physics_envs} envs on {on.torch}, bare mujoco_warp / ours"
        sides, goal = (controlled(handler, targets), bare), Goal(GOAL, applies=on.is_cuda)
        units = decimation * self.control_steps
        with handler:
            return self.compare(name, *sides, goal, units=units, before=begin, after=check)

    @part("render_128", 128)
    @part("render_256", 256)
    @part("unsimplified_128", 128, simplified=False)
    @part("unsimplified_256", 256, simplified=False)
    def render(self, image_size: int, *, simplified: bool = True) -> Measurement:
        """Compares RGB images as torch tensors to the bare tracer, which leaves packed pixels in its buffer.

        Ours includes the poses of the bodies, the appearance of each env, and unpacking. Both render one
        camera, square images of so many pixels a side. The bare tracer renders our simplified meshes too, or
        the robot's own. The seconds are those of an image of all envs.
        """
        import mujoco_warp as mjw

        from envs.mjcf.model import build_model
        from envs.simulators.mujoco.render import Stage
        from envs.simulators.mujoco.render_warp import create_context, ready_for_tracing

        handler = launched("mujoco_warp", self.render_envs, image_size, {"device": self.device})
        on, scenario = handler.on, handler.scenario
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
            cameras = tuple(camera.name for camera in scenario.cameras)
            context = create_context(stage.model, cameras, ("rgb",), num_worlds=handler.num_envs)

        def trace() -> None:
            mjw.refit_bvh(model, data, context)
            mjw.render(model, data, context)

        bare = on.capture(trace).launch if on.is_cuda else trace
        name = (
            f"RGB {image_size}×{image_size}, {self.render_envs} envs on {on.torch}, "
            f"bare mujoco_warp.render{'' if simplified else ' of unsimplified meshes'} / ours"
        )
        goal = Goal(GOAL if simplified else SIMPLIFIED_GOAL, applies=on.is_cuda)
        with handler, on.scope():
            return self.compare(name, handler.render_tensors, bare, goal, calls=self.images)


def put_physics(handler: Any) -> tuple[Any, Any]:
    """Returns the model of a handler and empty data, for bare mujoco_warp on the handler's device."""
    import mujoco_warp as mjw

    settings, model = handler.settings, handler.physics_model
    with handler.on.scope():
        warp_model = mjw.put_model(model)
        warp_model.opt.warn_overflow = 0
        data = mjw.make_data(model, nworld=handler.num_envs, nconmax=settings.nconmax, njmax=settings.njmax)
    return warp_model, data
