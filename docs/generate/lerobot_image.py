"""The image of LeRobot's recorder: what an unmodified ``lerobot-record`` wrote of a simulated robot.

``python -m docs.generate.lerobot_image`` runs ``lerobot-record`` with ``--robot.type=roboverse`` and the
expert in a temporary folder, reads the dataset that it leaves, and writes ``docs/howto/lerobot_robot.png``:
images of the episode up to its success, and three of its joints, as they were commanded and as they were.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.dataset.images import load_images

OUT = Path("docs/howto/lerobot_robot.png")
PIXELS, FPS, NUM_IMAGES = 192, 20, 4
JOINTS = ("joint2.pos", "joint4.pos", "gripper_finger_joint1.pos")
CAMERAS = ("front", "wrist")

_EPISODE_S = 15
"""Seconds of the wall, which a slow machine fills with fewer steps."""


def record(folder: Path) -> int:
    """Records an episode into ``folder/recorded``; returns the steps after which it was solved.

    Raises:
        RuntimeError: The command failed, or the episode was not solved.
    """
    words = [
        *("--robot.type=roboverse", "--robot.task=PickCube", f"--robot.image_size={PIXELS}"),
        f"--robot.cameras=[{','.join(CAMERAS)}]",
        *("--robot.outcomes=outcomes.jsonl", "--robot.discover_packages_path=envs.lerobot"),
        *("--teleop.type=roboverse_expert", "--dataset.repo_id=local/recorded", "--dataset.root=recorded"),
        *(f"--dataset.fps={FPS}", "--dataset.num_episodes=1", f"--dataset.episode_time_s={_EPISODE_S}"),
        *("--dataset.reset_time_s=0", "--dataset.single_task=Pick up the cube"),
        *("--dataset.push_to_hub=false", "--dataset.streaming_encoding=true"),
        *("--dataset.rgb_encoder.vcodec=h264", "--play_sounds=false"),
    ]
    done = subprocess.run(
        [Path(sys.executable).with_name("lerobot-record"), *words],
        cwd=folder,
        env=os.environ | {"HF_HUB_OFFLINE": "1", "PYTHONPATH": str(Path.cwd())},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"lerobot-record failed:\n{done.stdout[-4000:]}")
    outcome = json.loads((folder / "outcomes.jsonl").read_text(encoding="utf-8").splitlines()[0])
    if not outcome["success"]:
        raise RuntimeError(f"the episode was not solved within {_EPISODE_S} s of the wall: {outcome}")
    return int(outcome["solved_at"])


def draw(info: DatasetInfo, solved_at: int) -> None:
    """Draws the first episode of a dataset until its success."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    shown = np.linspace(0, solved_at, NUM_IMAGES).astype(int)
    keys = {camera: f"observation.images.{camera}" for camera in CAMERAS}
    images = load_images(info, [*keys.values()], memory_fraction=0.5, num_threads=1)
    columns = info.read_columns(["observation.state", "action"])
    names = {key: info.features[key]["names"] for key in columns}
    figure = plt.figure(figsize=(6.4, 7.0), layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.0))
    grid = rows[0].subplots(len(CAMERAS), NUM_IMAGES)
    for line, camera in zip(grid, CAMERAS, strict=True):
        for axis, step in zip(line, shown, strict=True):
            axis.imshow(images[keys[camera]][step].transpose(1, 2, 0))
            axis.set_xticks([])
            axis.set_yticks([])
        line[0].set_ylabel(camera, fontsize=14)
    for axis, step in zip(grid[0], shown, strict=True):
        axis.set_title(f"{step / FPS:.1f} s", fontsize=14)
    axis, seconds = rows[1].subplots(), np.arange(solved_at + 1) / FPS
    for index, joint in enumerate(JOINTS):
        for key, style in (("action", "-"), ("observation.state", ":")):
            values = columns[key][: solved_at + 1, names[key].index(joint)]
            unit = 100.0 if "finger" in joint else 1.0
            axis.plot(seconds, unit * values, style, color=f"C{index}", lw=2.0)
        axis.plot([], [], color=f"C{index}", label=joint + (", cm" if "finger" in joint else ", rad"))
    axis.plot([], [], "-", color="0.3", label="action")
    axis.plot([], [], ":", color="0.3", label="observation.state")
    axis.set_xlabel("timestamp, s", fontsize=13)
    axis.tick_params(labelsize=12)
    rows[1].legend(fontsize=12, ncols=2, loc="outside lower center", frameon=False)
    figure.savefig(OUT, dpi=100)
    plt.close(figure)


def main() -> None:
    """Writes the image."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        solved_at = record(folder)
        draw(DatasetInfo.open(folder / "recorded"), solved_at)


if __name__ == "__main__":
    main()
