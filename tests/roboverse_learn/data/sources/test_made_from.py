"""A dataset that was made from another one is not continued from what that one holds later."""

import shutil
from contextlib import nullcontext

import pytest

from envs.core.atomic import write_json
from envs.core.errors import DatasetError
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetWriter
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from roboverse_learn.data.sources import SOURCES
from roboverse_learn.data.sources.made_from import refuse_changed_origin
from tests.roboverse_learn.data.augmentation.expert_demos import write_demos
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode


def write(root, count, settings=None):
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        for index in range(count):
            writer.add_episode(make_episode(index))
    if settings is not None:
        write_json(root / COLLECTION_PATH, {"settings": settings, "failed": []})
    return root


@pytest.mark.parametrize("source", ["rerender", "retarget"])
def test_a_dataset_made_from_another_that_changed_since_is_refused_in_words(tmp_path, source):
    origin = write(tmp_path / "origin", 3)
    made = write(tmp_path / "made", 1, {"source": source, "dataset": "0123456789abcdef"})
    words = [f"source={source}", f"from={origin}", "task=PickCube"]
    demonstrations = SOURCES.get(source)(compose("collect", words))
    with pytest.raises(DatasetError) as refused:
        demonstrations.prepare(made, nullcontext)
    assert str(refused.value) == (
        f"The dataset '{made}' was made from other demonstrations: from={origin} has changed since, or is "
        "another dataset (3 demonstrations now). Name another folder with dataset=<folder>, or remove "
        f"'{made}' to make it anew."
    )
    made = write(tmp_path / "same", 1, demonstrations.identity())
    demonstrations.prepare(made, nullcontext)
    demonstrations.prepare(tmp_path / "new", nullcontext)


def test_a_dataset_of_another_source_or_without_episodes_is_left_to_its_settings(tmp_path):
    identity = {"source": "augment", "sources": "a"}
    for name, count, before in (("other", 1, {"source": "retarget"}), ("empty", 0, {"source": "augment"})):
        made = write(tmp_path / name, count, before)
        refuse_changed_origin(made, identity, "sources", "origin", now=1)


@pytest.mark.slow
def test_demonstrations_that_were_augmented_and_are_more_now_are_counted(tmp_path):
    origin, made = tmp_path / "origin", tmp_path / "made"
    words = ["source=augment", f"from={origin}", "num_demos=1", "image_size=16", f"dataset={made}"]
    write_demos(origin, "PickCube", 2)
    collect_dataset(compose("collect", [*words, "collect.num_workers=1", "collect.num_envs=1"]))
    shutil.rmtree(origin)
    write_demos(origin, "PickCube", 3)
    with pytest.raises(
        DatasetError, match=r"has grown since \(2 demonstrations then, 3 now\). Name another f"
    ):
        collect_dataset(compose("collect", words))
