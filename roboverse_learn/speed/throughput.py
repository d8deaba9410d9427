"""``env.step`` against ``mj_step``, an image against MuJoCo's GL: ``roboverse speed throughput``."""

import ctypes.util
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from envs.core.errors import SimulatorError
from roboverse_learn.speed.harness import Goal, Measurement, Settings, in_turns, measurement, program

IMAGE_SIZE = 128
OVERHEAD, SPEEDUP = Goal(1.10, at_least=False), Goal(10.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class ThroughputSettings(Settings):
    """Compares env.step to a bare mj_step loop, and an image to MuJoCo's GL.

    Attributes:
        parts: step, step_without_visuals (the loop leaves out what is only seen, as the env does), render.
        task: Registered task.
        turns: How often each side is timed.
        out: JSON file for the measurements.
    """

    task: str = "PickCube"
    turns: int = 15


def parts(settings: ThroughputSettings) -> Mapping[str, Callable[[], Measurement]]:
    """Returns what is measured."""
    task, turns = settings.task, settings.turns
    return {
        "step": partial(measure_step, task, turns),
        "step_without_visuals": partial(measure_step, task, turns, visuals=False),
        "render": partial(measure_render, task, turns),
    }


def measure_step(task: str, turns: int, *, num_steps: int = 100, visuals: bool = True) -> Measurement:
    """Compares ``env.step`` of one env with state observations to a bare ``mj_step`` loop.

    Both take the same actions from the same states, and must end in the same state.

    Args:
        task: Task.
        turns: How often each side is timed.
        num_steps: Control steps per turn.
        visuals: Whether the loop steps the scene as it is, or what the env steps: the scene without what is
            only seen, which takes a tenth less time.

    Raises:
        SimulatorError: The two did not end in the same state.
    """
    import mujoco

    from envs import RoboVerseEnv

    env = RoboVerseEnv(task, split="test", observation="state", num_threads=1)
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
        data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = start.qpos, start.mocap_pos, start.mocap_quat

    def ours() -> None:
        for action in actions:
            env.step(action)

    def bare() -> None:
        for targets in path.reshape(-1, path.shape[-1]):
            data.ctrl[:] = targets
            mujoco.mj_step(model, data)

    def check() -> None:
        qpos = handler.snapshot()[0].qpos
        if not np.allclose(qpos, data.qpos, atol=1e-8):
            gap = np.abs(qpos - data.qpos).max()
            raise SimulatorError(f"env.step and mj_step ended {gap:.2g} apart: this is not the same physics.")

    seconds = in_turns(ours, bare, turns, before=reset, after=check)
    env.close()
    name = f"env.step (1 env, state) / bare mj_step loop{'' if visuals else ' without visuals'}"
    return measurement(name, seconds, OVERHEAD, units=num_steps)


def measure_render(task: str, turns: int) -> Measurement:
    """Compares an image of the default renderer to the same one of MuJoCo's GL, rendered in software.

    The baseline renders the robot's own meshes; ours are simplified. One core, with shadows.

    Args:
        task: Task.
        turns: How often each side is timed.

    Raises:
        SimulatorError: OSMesa is not installed, or another GL was chosen.
    """
    if os.environ.get("MUJOCO_GL") != "osmesa":
        raise SimulatorError("MUJOCO_GL is not 'osmesa'; the baseline is a software rasterizer on one core.")
    if ctypes.util.find_library("OSMesa") is None:
        raise SimulatorError("libOSMesa is not installed; on Debian and Ubuntu: apt-get install libosmesa6.")
    ours = _handler(task, "warp", simplify_meshes=True)
    baseline = _handler(task, "gl", simplify_meshes=False)
    seconds = in_turns(ours.render, baseline.render, turns)
    ours.close()
    baseline.close()
    return measurement(f"RGB {IMAGE_SIZE}×{IMAGE_SIZE}, MuJoCo GL (OSMesa) / warp", seconds, SPEEDUP)


def _handler(task: str, renderer: str, *, simplify_meshes: bool) -> Any:
    """Returns a handler with one env at the first test episode's start, under a light with shadows."""
    from envs import make_vec

    with_looks = make_vec(task, 1, split="test", image_size=IMAGE_SIZE)
    episode = int(with_looks.split_indices[0])
    with_looks.reset_envs([0], [episode])
    looks = with_looks.randomizer.appearance(episode)
    lights = (replace(looks.lights[0], cast_shadow=True), *looks.lights[1:])
    build: Any = type(with_looks.handler)
    handler = build(
        with_looks.scenario,
        1,
        renderer=renderer,
        num_threads=1,
        textures=with_looks.randomizer.library.texture,
        simplify_meshes=simplify_meshes,
    )
    handler.launch()
    handler.set_states(with_looks.get_states())
    handler.set_appearance(replace(looks, lights=lights), 0)
    with_looks.close()
    return handler


if __name__ == "__main__":
    # MuJoCo reads both when it starts.
    gl = {"MUJOCO_GL": "osmesa"}
    sys.exit(program("throughput", ThroughputSettings, parts, one_core=True, environment=gl))
