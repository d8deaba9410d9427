"""``env.step`` against ``mj_step``, an image against MuJoCo's GL: ``roboverse speed throughput``."""

import contextlib
import ctypes.util
import os
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Program, part, require_same_physics

IMAGE_SIZE = 128
RENDER_TURNS = 5
OVERHEAD, SPEEDUP = Goal(1.10, at_least=False), Goal(10.0)


def with_shadows(looks: Any, *, cast: bool = True) -> Any:
    """Returns an appearance whose first light casts shadows, or does not."""
    return replace(looks, lights=(replace(looks.lights[0], cast_shadow=cast), *looks.lights[1:]))


@dataclass(frozen=True, kw_only=True, slots=True)
class Throughput(Program):
    """Compares env.step to a bare mj_step loop, and an image to MuJoCo's GL.

    Attributes:
        parts: step, step_without_visuals (the loop leaves out what is only seen, as the env does), render.
        task: Registered task.
        turns: How often each side is timed; up to five times where it renders an episode.
    """

    one_core: ClassVar = True
    environment: ClassVar = {"MUJOCO_GL": "osmesa"}  # MuJoCo reads it when it starts

    task: str = "PickCube"
    turns: int = 15

    @part("step")
    @part("step_without_visuals", visuals=False)
    def step(self, *, num_steps: int = 100, visuals: bool = True) -> Measurement:
        """Compares ``env.step`` of one env with state observations to a bare ``mj_step`` loop.

        Both take the same actions from the same states, and must end in the same state. The loop steps the
        scene as it is, or without ``visuals`` what the env steps: the scene without what is only seen, which
        takes a tenth less time.
        """
        import mujoco

        from envs import RoboVerseEnv

        env = RoboVerseEnv(self.task, split="test", observation="state", num_threads=1)
        handler: Any = env.batch.handler  # MuJoCo's, whose model is not part of the interface
        scenario, episodes = env.batch.scenario, iter(env.batch.split_indices)
        model = handler.model if visuals else handler.physics_model
        data = mujoco.MjData(model)
        rest = np.array(scenario.robots[0].default_qpos)
        phase = np.arange(num_steps)[:, None] / 10
        actions = (rest + 0.1 * np.sin(phase + np.arange(len(rest)))).astype(np.float32)
        actions = np.clip(actions, *model.actuator_ctrlrange.T)
        decimation = scenario.physics.decimation
        share = np.arange(1, decimation + 1)[:, None] / decimation
        begin = np.concatenate([[rest], actions[:-1]])
        path = begin[:, None] * (1.0 - share) + actions[:, None] * share  # (num_steps, decimation, nu)

        def reset() -> None:
            env.reset(options={"episode": int(next(episodes))})
            handler.set_joint_targets({scenario.robots[0].name: rest[None]})
            (start,) = handler.snapshot()
            mujoco.mj_resetData(model, data)
            for name in ("qpos", "mocap_pos", "mocap_quat"):
                getattr(data, name)[:] = getattr(start, name)

        def ours() -> None:
            for action in actions:
                env.step(action)

        def bare() -> None:
            for targets in path.reshape(-1, path.shape[-1]):
                data.ctrl[:] = targets
                mujoco.mj_step(model, data)

        def check() -> None:
            require_same_physics(np.abs(handler.snapshot()[0].qpos - data.qpos).max(), 1e-8)

        name = f"env.step (1 env, state) / bare mj_step loop{'' if visuals else ' without visuals'}"
        with contextlib.closing(env):
            return self.compare(name, ours, bare, OVERHEAD, units=num_steps, before=reset, after=check)

    @part("render")
    def render(self) -> Measurement:
        """Compares images of the default renderer to the same ones of MuJoCo's GL, rendered in software.

        They are of an episode in which the arm moves the cube, in order, as a collection renders them. The
        baseline renders the robot's own meshes; ours are simplified. One core, whose time is counted, with
        shadows. How alike the images are is tested by ``tests/contracts/test_image_quality.py``.

        Raises:
            SimulatorError: OSMesa is not installed, or another GL was chosen.
        """
        if os.environ.get("MUJOCO_GL") != "osmesa":
            raise SimulatorError(
                "MUJOCO_GL is not 'osmesa'; the baseline is a software rasterizer on one core."
            )
        if ctypes.util.find_library("OSMesa") is None:
            raise SimulatorError(
                "libOSMesa is not installed; on Debian and Ubuntu: apt-get install libosmesa6."
            )
        from envs import make_vec
        from envs.experts.actor import ExpertActor
        from envs.rollout import rollout

        env = make_vec(self.task, 1, split="test", image_size=IMAGE_SIZE, num_threads=1)
        ours: Any = env.handler
        jobs: list[Any] = []
        expert = ExpertActor(env)
        for _ in rollout(env, expert, env.split_indices[:1], on_step=lambda _: jobs.extend(ours.snapshot())):
            pass
        looks = with_shadows(jobs[0].appearance)
        jobs = [replace(job, appearance=looks) for job in jobs]
        own = {"renderer": "gl", "num_threads": 1, "textures": env.randomizer.library.texture}
        with contextlib.closing(env), type(ours)(env.scenario, 1, **own, simplify_meshes=False) as baseline:
            baseline.launch()

            def draw(handler: Any) -> None:
                for job in jobs:
                    handler.render_jobs([job])

            name = f"RGB {IMAGE_SIZE}×{IMAGE_SIZE}, MuJoCo GL (OSMesa) / warp"
            how: Any = {"units": len(jobs), "clock": time.process_time}
            how |= {"turns": min(self.turns, RENDER_TURNS)}
            return self.compare(name, partial(draw, ours), partial(draw, baseline), SPEEDUP, **how)
