import os
from pathlib import Path

import pytest

os.environ.setdefault("HF_HUB_OFFLINE", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")


@pytest.fixture(scope="session", autouse=True)
def _private_table_cache(tmp_path_factory):
    """LeRobot copies every table it opens into a cache; keep it out of the home folder."""
    import datasets

    before = datasets.config.HF_DATASETS_CACHE
    datasets.config.HF_DATASETS_CACHE = tmp_path_factory.mktemp("hf_datasets")
    yield
    datasets.config.HF_DATASETS_CACHE = before


@pytest.fixture(scope="session")
def written(tmp_path_factory) -> Path:
    """A closed dataset of six episodes; tests only read it."""
    from roboverse_learn.data import DatasetWriter
    from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode

    root = tmp_path_factory.mktemp("written") / "dataset"
    with DatasetWriter(root, fps=FPS, features=FEATURES, robot_type="franka") as writer:
        for index in range(6):
            writer.add_episode(make_episode(index, task="lift the cube" if index % 2 else "push the cube"))
    return root


@pytest.fixture(scope="session")
def open_with_lerobot():
    """Opens a folder with LeRobot's own, unmodified reader."""

    def open_dataset(root, **kwargs):
        from lerobot.datasets.lerobot_dataset import LeRobotDataset

        return LeRobotDataset("local/test", root=root, video_backend="pyav", return_uint8=True, **kwargs)

    return open_dataset
