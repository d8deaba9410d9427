"""Two datasets on disk whose images and joints are alike: only the instruction tells their actions apart."""

from pathlib import Path

import numpy as np

from roboverse_learn.data import DatasetWriter, EpisodeData, make_features

FPS, SIZE = 20, 32
TEXTS = {"Right": ("push the cube right", "shove the cube right"), "Left": ("push the cube left",)}
NUM_ACTIONS = {"Right": 3, "Left": 2}
SIGN = {"Right": 1.0, "Left": -1.0}


def square_of(index: int) -> tuple[np.ndarray, float]:
    """Returns an image with a bright square, and its height in the image, from −1 at the top to 1."""
    rng = np.random.default_rng(index)
    row, column = rng.integers(0, SIZE - 8, 2)
    image = np.full((SIZE, SIZE, 3), 60, np.uint8)
    image[row : row + 8, column : column + 8] = 240
    return image, float(row / (SIZE - 8) * 2 - 1)


def expected_action(task: str, index: int) -> np.ndarray:
    """Returns the action of every frame of an episode: 1 or −1, and the square's height either way."""
    _, height = square_of(index)
    values = np.array([1.0, height, 0.5])[: NUM_ACTIONS[task]]
    return (SIGN[task] * values).astype(np.float32)


def make_episode(task: str, index: int, text: str, length: int) -> EpisodeData:
    image, _ = square_of(index)
    num = NUM_ACTIONS[task]
    return EpisodeData(
        states=np.random.default_rng(100 + index).normal(size=(length, 4)).astype(np.float32),
        actions=np.tile(expected_action(task, index), (length, 1)),
        images={"front": np.tile(image, (length, 1, 1, 1))},
        task=text,
        raw={"qpos": np.zeros((length + 1, 1)), "ctrl": np.zeros((length, num))},
        metadata={"task": task, "level": 0, "split": "train", "episode": index},
    )


def write(root: Path, task: str, num_episodes: int, texts: tuple[str, ...] = (), length: int = 5) -> Path:
    """Writes the dataset of a task; its episodes take the wordings in turn."""
    texts = texts or TEXTS[task]
    actions = [f"a{i}" for i in range(NUM_ACTIONS[task])]
    features = make_features([f"q{i}" for i in range(4)], actions, {"front": (SIZE, SIZE)})
    with DatasetWriter(root, fps=FPS, features=features) as writer:
        for index in range(num_episodes):
            writer.add_episode(make_episode(task, index, texts[index % len(texts)], length))
    return root
