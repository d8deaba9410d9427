"""Speed of the parts, each as a ratio to a reference that is timed in the same run: ``roboverse speed``."""

import subprocess
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from envs.core.registry import Registry

if TYPE_CHECKING:
    from roboverse_learn.speed.harness import Program

PROGRAMS: "Registry[type[Program]]" = Registry("speed program")
"""Each runs as a process, so that threads and GL are set before a simulator is imported."""

for _name, _summary in {
    "throughput": "env.step against a bare mj_step loop; an image against MuJoCo's GL (needs libosmesa6)",
    "dataset": "writing demonstrations and reading batches, against LeRobot",
    "evaluation": "evaluation of an ACT checkpoint on the same episodes, against lerobot-eval",
    "peers": "a control step against those of ManiSkill 3 and robosuite, where they are installed",
    "mujoco_warp": "simulator=mujoco_warp against bare mujoco_warp: physics and images (needs a GPU)",
    "simulators": "handlers against scripts on the simulator alone",
    "training": "a gradient step of ACT and Diffusion Policy against LeRobot, and the losses (needs a GPU)",
    "processes": "training in several processes, a GPU each, against one: efficiency (needs two GPUs)",
    "vla": "a gradient step of SmolVLA, whole and with LoRA, against LeRobot (extra vla; needs a GPU)",
    "rl": "PPO on TorchVectorEnv against bare mujoco_warp; cost of the adapters (needs a GPU)",
    "agents": "TD-MPC2 and FastTD3 against plain torch, the replay buffer against TorchRL (needs a GPU)",
    "teleoperation": "teleoperation on one core: command to image, images, lateness of control steps",
    "startup": "roboverse list, --help and a first image, against an empty Python program",
}.items():
    _class = _name.title().replace("_", "")
    PROGRAMS.add(_name, f"roboverse_learn.speed.{_name}:{_class}", summary=_summary)


def run(name: str, words: Sequence[str] = ()) -> int:
    """Runs one program in a process of its own, which prints a table of what it measured.

    Args:
        name: Registered program.
        words: Its keys, ``key=value``.

    Returns:
        Its exit code: 1 if a goal was missed or something could not be measured, 2 for wrong keys.

    Raises:
        UnknownNameError: if there is no such program.
    """
    PROGRAMS.entry(name)
    return subprocess.run([sys.executable, "-m", __name__, name, *words], check=False).returncode
