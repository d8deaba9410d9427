"""Records how LIBERO's episodes begin for a policy in LeRobot's own environment: ``original_starts.json``.

The file is ``tests/envs/tasks/libero/original_starts.json``: states of some of the 50 starts, and small images
of the first. It runs in an environment of its own, that of ``docs/generate/robosuite_motion.py`` with LeRobot beside:

    uv pip install --python original "lerobot[dataset,evaluation]==0.6.1" "mujoco==3.2.7"
    LIBERO_CONFIG_PATH=<folder of its config.yaml> MUJOCO_GL=osmesa original/bin/python docs/generate/libero_starts.py

The library of OSMesa (``apt-get install libosmesa6``) renders without a GPU. The same environment evaluates a checkpoint:

    MUJOCO_GL=osmesa original/bin/lerobot-eval --env.type=libero --env.task=libero_goal --env.task_ids=[7] \
        --policy.path=<folder> --eval.n_episodes=50 --eval.batch_size=1
"""  # noqa: E501

import json
from pathlib import Path

import numpy as np
from lerobot.envs.configs import LiberoEnv
from lerobot.envs.utils import preprocess_observation

FILE = Path(__file__).resolve().parents[2] / "tests" / "envs" / "tasks" / "libero" / "original_starts.json"
SUITE, TASK_ID, TASK = "libero_goal", 7, "libero/goal/turn_on_the_stove"
COUNT, PX, SMALL_PX = 5, 256, 16


def main() -> None:
    """Writes the file."""
    config = LiberoEnv(task=SUITE, task_ids=[TASK_ID], observation_height=PX, observation_width=PX)
    env, (process, _) = config.create_envs(1)[SUITE][TASK_ID], config.get_env_processors()
    states, images = [], {}
    for index in range(COUNT):
        seen = process(preprocess_observation(env.reset(seed=[index])[0]))
        states.append([round(float(value), 5) for value in seen["observation.state"][0]])
        if not images:
            images = {name: _small(seen[f"observation.images.{name}"][0]) for name in ("image", "image2")}
    rows = ",\n  ".join(map(json.dumps, states))
    pixels = ",\n  ".join(f"{json.dumps(name)}: {json.dumps(image)}" for name, image in images.items())
    FILE.write_text(
        f'{{\n "task": "{TASK}",\n "states": [\n  {rows}\n ],\n "images": {{\n  {pixels}\n }}\n}}\n'
    )
    env.close()


def _small(image) -> list:
    """Returns means of squares of an image (3, H, W) from 0 to 1, as rows of columns of colours to 255."""
    squares = np.asarray(image).transpose(1, 2, 0).reshape(SMALL_PX, PX // SMALL_PX, SMALL_PX, -1, 3)
    return np.round(255 * squares.mean(axis=(1, 3))).astype(int).tolist()


if __name__ == "__main__":
    main()
