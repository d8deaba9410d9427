"""``env.step`` against ``mj_step``, an image against MuJoCo's GL: ``roboverse speed throughput``."""

import ctypes.util
import os
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, override

import numpy as np

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Parts, Program, compare, require_same_physics

IMAGE_SIZE = 128
OVERHEAD, SPEEDUP = Goal(1.10, at_least=False), Goal(10.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Throughput(Program):
    """Compares env.step to a bare mj_step loop, and an image to MuJoCo's GL.

    Attributes:
        parts: step, step_without_visuals (the loop leaves out what is only seen, as the env does), render.
        task: Registered task.
        turns: How often each side is timed.
    """

    one_core: ClassVar = True
    environment: ClassVar = {"MUJOCO_GL": "osmesa"}  # MuJoCo reads it when it starts

    task: str = "PickCube"
    turns: int = 15

    @override
    def measurements(self) -> Parts:
        return {
            "step": self.step,
            "step_without_visuals": partial(self.step, visuals=False),
            "render": self.render,
        }

    def step(self, *, num_steps: int = 100, visuals: bool = True) -> Measurement:
        """Compares ``env.step`` of one env with state observations to a bare ``mj_step`` loop.

        Both take the same actions from the same states, and must end in the same state. The loop steps the
        scene as it is, or without ``visuals`` what the env steps: the scene without what is only seen, which
        takes a tenth less time.

        Raises:
            SimulatorError: The two did not end in the same state.
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
            data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = (
                start.qpos,
                start.mocap_pos,
                start.mocap_quat,
            )

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
        found = compare(
            name, ours, bare, OVERHEAD, turns=self.turns, units=num_steps, before=reset, after=check
        )
        env.close()
        return found

    def render(self) -> Measurement:
        """Compares an image of the default renderer to the same one of MuJoCo's GL, rendered in software.

        The baseline renders the robot's own meshes; ours are simplified. One core, with shadows.

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

        env = make_vec(self.task, 1, split="test", image_size=IMAGE_SIZE, num_threads=1)
        episode = int(env.split_indices[0])
        env.reset_envs([0], [episode])
        looks = env.randomizer.appearance(episode)
        lights = (replace(looks.lights[0], cast_shadow=True), *looks.lights[1:])
        ours: Any = env.handler
        baseline = type(ours)(
            env.scenario,
            1,
            renderer="gl",
            num_threads=1,
            textures=env.randomizer.library.texture,
            simplify_meshes=False,
        )
        baseline.launch()
        baseline.set_states(env.get_states())
        for handler in (ours, baseline):
            handler.set_appearance(replace(looks, lights=lights), 0)
        name = f"RGB {IMAGE_SIZE}×{IMAGE_SIZE}, MuJoCo GL (OSMesa) / warp"
        found = compare(name, ours.render, baseline.render, SPEEDUP, turns=self.turns)
        baseline.close()
        env.close()
        return found
