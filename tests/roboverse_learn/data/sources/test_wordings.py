"""Datasets of the channel ``language``: several known wordings of one task, in LeRobot's table of tasks."""

from dataclasses import replace

import pytest

from envs.randomization.language import bank_of
from envs.tasks.pick_cube import PickCube
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo

KNOWN = {*bank_of(PickCube.instructions).known}


def wordings(root, *words):
    """Collects, and returns the instruction of each episode as LeRobot reads it."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    own = ["task=PickCube", "image_size=16", "num_workers=1", "only=language", f"dataset={root}", *words]
    config = compose("collect", own)
    collect_dataset(replace(config, collect=replace(config.collect, num_envs=3)))
    info, dataset = DatasetInfo.open(root), LeRobotDataset("local/words", root=root, video_backend="pyav")
    assert info.episode_metadata[0]["only"] == "language"
    starts = dataset.meta.episodes["dataset_from_index"]
    table = {int(row): words for words, row in dataset.meta.tasks["task_index"].items()}
    return [table[int(dataset.hf_dataset[int(start)]["task_index"])] for start in starts]


@pytest.mark.slow
def test_every_episode_has_a_known_wording_of_its_own(tmp_path):
    first = wordings(tmp_path / "first", "num_demos=3")
    assert len(first) == 3 and len({*first}) > 1 and {*first} <= KNOWN
    looks = wordings(tmp_path / "looks", "num_demos=9", "source=rerender", f"from={tmp_path / 'first'}")
    assert looks[:3] == first, "the first look of an episode is its own"
    assert {*looks} <= KNOWN and len({*looks}) > len({*first}), "each further one has other words"
