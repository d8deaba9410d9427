"""An environment of another project, stepped by :mod:`roboverse_learn.speed.peers`.

The Python that runs this file has that project's packages, whose versions are seldom ours, so it imports
nothing of ours: ``python peer_env.py robosuite state 128``. It prints a line once it is ready; then each
line on its standard input is a number of control steps, which it answers with the seconds of CPU time that
they took.
"""

import importlib
import sys
import time
from collections.abc import Callable


def robosuite(sees: str, size: int) -> Callable[[], object]:
    """Returns what makes a step of robosuite's Lift: a Panda at 20 Hz, held by its default controller."""
    import numpy as np
    import robosuite as suite

    images = sees == "images"
    env = suite.make(
        "Lift",
        robots="Panda",
        has_renderer=False,
        has_offscreen_renderer=images,
        use_camera_obs=images,
        camera_names="agentview",
        camera_heights=size,
        camera_widths=size,
        use_object_obs=True,
        control_freq=20,
        horizon=1_000_000,
    )
    env.reset()
    hold = np.zeros(env.action_spec[0].shape)
    first = env.step(hold)[0]
    if images and first["agentview_image"].shape != (size, size, 3):
        raise SystemExit(f"robosuite's image is {first['agentview_image'].shape}")
    return lambda: env.step(hold)


def maniskill(sees: str, size: int) -> Callable[[], object]:
    """Returns what makes a step of ManiSkill's PickCube on a CPU: a Panda at 20 Hz, held by joint targets."""
    import gymnasium
    import numpy as np

    importlib.import_module("mani_skill.envs")  # registers

    cameras = {"width": size, "height": size}
    env = gymnasium.make(
        "PickCube-v1",
        obs_mode="rgb" if sees == "images" else "state",
        control_mode="pd_joint_delta_pos",
        sim_backend="physx_cpu",
        sensor_configs=cameras,
        max_episode_steps=1_000_000,
    )
    env.reset(seed=0)
    hold = np.zeros_like(env.action_space.sample())
    return lambda: env.step(hold)


def main(name: str, sees: str, size: str) -> None:
    """Answers numbers of steps with seconds until the standard input ends."""
    step = {"robosuite": robosuite, "maniskill": maniskill}[name](sees, int(size))
    _answer("ready")
    for line in sys.stdin:
        started = time.process_time()
        for _ in range(int(line)):
            step()
        _answer(time.process_time() - started)


def _answer(value: object) -> None:
    sys.stdout.write(f"peer_env: {value}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
