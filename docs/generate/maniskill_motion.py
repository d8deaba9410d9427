"""Records motions of ManiSkill's Panda by its delta actions: ``tests/envs/tasks/maniskill_motion.json``.

It runs in an environment of its own, which has ManiSkill and nothing of this project:

    uv venv original
    uv pip install --python original mani_skill==3.0.1 "numpy<2"
    original/bin/python docs/generate/maniskill_motion.py

Actions of the file are kept where there are some: the joints are recorded again. The hand first goes up, so
that the arm touches nothing.
"""

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import mani_skill.envs  # pyright: ignore[reportMissingImports]  # noqa: F401
import numpy as np
from maniskill_unseen import without_materials  # beside this file, which is run by its path

FILE = Path(__file__).resolve().parents[2] / "tests" / "envs" / "tasks" / "maniskill_motion.json"
UP = {
    "pd_joint_delta_pos": [0.0, -0.8, 0.0, 0.3, 0.0, 0.0, 0.0, 1.0],
    "pd_ee_delta_pose": [0.0, 0.0, 0.35, 0.0, 0.0, 0.0, 1.0],
}
REPEAT, UP_ACTIONS, ACTIONS = 5, 3, 10


def main() -> None:
    """Runs the motions and writes the file."""
    without_materials()
    motions = json.loads(FILE.read_text()) if FILE.is_file() else {}
    for mode, up in UP.items():
        actions = motions.get(mode, {}).get("actions") or _drawn(up)
        env = gym.make(
            "PickCube-v1", obs_mode="none", control_mode=mode, render_backend="none", sim_backend="cpu"
        )
        env.reset(seed=0)
        robot = env.unwrapped.agent.robot  # pyright: ignore[reportAttributeAccessIssue]
        joints = [_read(robot)]
        for action in actions:
            for _ in range(REPEAT):
                env.step(np.array(action))
            joints.append(_read(robot))
        motions[mode] = {"repeat": REPEAT, "actions": actions, "joints": joints}
        env.close()
    FILE.write_text(_text(motions))


def _drawn(up: list[float]) -> list[list[float]]:
    rng = np.random.default_rng(0)
    drawn = rng.uniform(-0.2, 0.2, (ACTIONS - UP_ACTIONS, len(up)))
    drawn[:, -1] = np.resize([-1.0, 1.0, 0.2], len(drawn))
    return [up] * UP_ACTIONS + [[round(float(value), 3) for value in row] for row in drawn]


def _read(robot: Any) -> list[float]:
    return [round(float(value), 6) for value in robot.get_qpos()[0]]


def _text(motions: dict) -> str:
    """Returns the file's content: an action and a posture per line."""
    parts = []
    for mode, motion in motions.items():
        rows = {
            key: "[\n   " + ",\n   ".join(map(json.dumps, motion[key])) + "\n  ]"
            for key in ("actions", "joints")
        }
        lines = [f'"repeat": {motion["repeat"]}', *(f'"{key}": {text}' for key, text in rows.items())]
        parts.append(f' "{mode}": {{\n  ' + ",\n  ".join(lines) + "\n }")
    return "{\n" + ",\n".join(parts) + "\n}\n"


if __name__ == "__main__":
    main()
