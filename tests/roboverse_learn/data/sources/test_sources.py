from dataclasses import replace
from typing import ClassVar

import pytest

from envs.core.errors import ConfigError
from envs.randomization.splits import load_split
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo
from roboverse_learn.data.collection import limits
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.data.sources.base import DemonstrationSource
from roboverse_learn.data.sources.expert import ExpertSource


class EvenSource(DemonstrationSource):
    """A source of a user's own."""

    episodes: ClassVar = ExpertSource.episodes
    needs: ClassVar = {"path": "<folder of even episodes>."}

    def name_part(self):
        return "even"

    def identity(self):
        return {"source": "even"}

    def candidates(self):
        return [index for index in super().candidates() if index % 2 == 0][:4]


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(SOURCES, "_entries", dict(SOURCES._entries))
    SOURCES.add("even", EvenSource)


@pytest.mark.slow
@pytest.mark.usefixtures("registered")
def test_source_of_another_package_collects(tmp_path):
    words = ["source=even", "task=PickCube", "image_size=32", f"datasets_dir={tmp_path}", "num_demos=2"]
    with pytest.raises(ConfigError, match="source=even needs path=<folder of even episodes>"):
        compose("collect", words)
    config = compose("collect", [*words, "path=x", "collect.num_workers=1", "collect.num_envs=2"])
    assert dataset_folder(config).name.endswith("-2demos-even")
    collect_dataset(config)
    info = DatasetInfo.open(dataset_folder(config))
    assert info.num_episodes == 2
    assert all(metadata["episode"] % 2 == 0 for metadata in info.episode_metadata)


def test_demonstrations_leave_the_validation_split_out_while_they_can():
    train, validation = (load_split(name).episodes.tolist() for name in ("train", "validation"))
    for num_demos, expected in ((8000, train[:8000]), (8001, train)):
        config = compose("collect", ["task=PickCube", f"num_demos={num_demos}"])
        assert SOURCES.get("expert")(config).candidates() == expected
    assert not set(train[:8000]) & set(validation)


def test_workers_and_environments_are_bounded_by_the_machine(monkeypatch, caplog):
    monkeypatch.setattr(limits, "num_cores", lambda: 4)
    config = compose("collect", ["num_workers=1000000", "collect.num_envs=1000000000"])
    lowered = limits.within_machine(config).collect
    assert lowered.num_workers <= 4 and lowered.num_envs < 1_000_000
    assert "num_workers=1000000 with num_envs=1000000000 is more than this machine holds" in caplog.text
    caplog.clear()
    small = replace(config, collect=replace(config.collect, num_workers=1, num_envs=1))
    assert limits.within_machine(small) == small and not caplog.text
    default = replace(config, collect=replace(config.collect, num_workers=0, num_envs=1))
    assert limits.within_machine(default).collect.num_workers <= 4 and not caplog.text
