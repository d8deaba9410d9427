"""A dataset that is rendered again has its states, and the images that collecting at that level gives."""

from dataclasses import replace

import numpy as np
import pytest

from envs.core.errors import ConfigError, DatasetError
from envs.randomization import load_split
from roboverse_learn.collect import collect_dataset
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, ResidentDataset, dataset_hash, merge, read_raw
from roboverse_learn.data.dataset.info import episode_key
from roboverse_learn.data.sources.rerender import Looks, source_facts

TRAIN = load_split("train").episodes.tolist()
SCENE = ["task=PickCube", "image_size=16", "num_workers=1"]


def collected(root, *words):
    config = compose("collect", [*SCENE, f"dataset={root}", *words])
    return collect_dataset(replace(config, collect=replace(config.collect, num_envs=2)))


@pytest.fixture(scope="module")
def at_level_0(tmp_path_factory):
    root = tmp_path_factory.mktemp("source") / "level0"
    collected(root, "num_demos=2", "level=0")
    return root


@pytest.mark.slow
def test_the_first_look_is_what_the_expert_collects_at_that_level(at_level_0, tmp_path):
    collected(tmp_path / "direct", "num_demos=2", "level=3")
    collected(tmp_path / "again", "num_demos=4", "level=3", "source=rerender", f"from={at_level_0}")
    direct, again = DatasetInfo.open(tmp_path / "direct"), DatasetInfo.open(tmp_path / "again")
    frames = direct.num_frames
    assert again.num_frames == 2 * frames
    for key, values in direct.read_columns(["observation.state", "action", "task_index"]).items():
        np.testing.assert_array_equal(again.read_columns([key])[key][:frames], values)
    for index in range(2):
        expected, _ = read_raw(direct.root, index)
        for look in (0, 1):
            states, facts = read_raw(again.root, index + 2 * look)
            assert facts["look"] == look and facts["dataset"] == dataset_hash(at_level_0)[:16]
            assert all(np.array_equal(states[key], values) for key, values in expected.items())
    key = "observation.images.front"
    first, both = (ResidentDataset(info.root) for info in (direct, again))
    rows = list(range(frames))
    images = both.sample(rows, {key: [0]})[key]
    assert bool((images == first.sample(rows, {key: [0]})[key]).all())
    others = both.sample([row + frames for row in rows], {key: [0]})[key]
    assert float((others.float() - images.float()).abs().mean()) > 0.05 * float(images.max())


def images_of(root):
    info = DatasetInfo.open(root)
    key = "observation.images.front"
    return ResidentDataset(info.root).sample(list(range(info.num_frames)), {key: [0]})[key]


@pytest.mark.slow
def test_disturbed_images_are_stored_once_by_collecting_and_by_rendering_again(at_level_0, tmp_path):
    collected(tmp_path / "direct", "num_demos=2", "only=sensor")
    collected(tmp_path / "again", "num_demos=2", "only=sensor", "source=rerender", f"from={at_level_0}")
    direct, again, plain = (images_of(root) for root in (tmp_path / "direct", tmp_path / "again", at_level_0))
    assert bool((direct == again).all()) and not bool((direct == plain).all())


@pytest.mark.slow
@pytest.mark.long
def test_a_dataset_gets_distractors_and_loses_them_again(at_level_0, tmp_path):
    given = f"from={at_level_0}"
    collected(tmp_path / "layout", "num_demos=2", "only=layout")
    collected(tmp_path / "got", "num_demos=2", "only=layout", "source=rerender", given)
    given = f"from={tmp_path / 'layout'}"
    collected(tmp_path / "lost", "num_demos=2", "level=0", "source=rerender", given)
    with_them, got, lost, plain = (
        images_of(root) for root in (tmp_path / "layout", tmp_path / "got", tmp_path / "lost", at_level_0)
    )
    assert bool((with_them == got).all()) and bool((lost == plain).all())
    assert not bool((with_them == plain).all())
    assert any(key.startswith("objects/distractor") for key in read_raw(tmp_path / "layout", 0)[0])


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_looks_do_not_depend_on_the_number_of_environments_and_processes(at_level_0, tmp_path):
    words = ["level=1", "source=rerender", f"from={at_level_0}", "num_demos=5"]
    one = collected(tmp_path / "one", *words)
    config = compose("collect", [*SCENE[:2], *words, f"dataset={tmp_path / 'two'}"])
    two = collect_dataset(replace(config, collect=replace(config.collect, num_envs=3, num_workers=2)))
    assert one.dataset_hash == two.dataset_hash


def test_further_looks_take_indices_that_no_episode_has():
    looks = Looks([TRAIN[3], TRAIN[0]], TRAIN)
    assert looks.indices[:5] == [TRAIN[3], TRAIN[0], TRAIN[1], TRAIN[2], TRAIN[4]]
    assert sorted(looks.indices) == TRAIN
    assert [looks.recording_of(index) for index in looks.indices[:5]] == [
        (0, 0),
        (1, 0),
        (0, 1),
        (1, 1),
        (0, 2),
    ]


def test_a_further_look_is_another_episode_and_the_first_is_not():
    recorded = {"task": "PickCube", "level": 3, "split": "train", "episode": 4, "simulator": "mujoco"}
    first, second = (recorded | source_facts(recorded, look) for look in (0, 1))
    assert episode_key(first) == episode_key(recorded) != episode_key(second)


@pytest.mark.slow
def test_datasets_that_cannot_be_rendered_again_are_refused(at_level_0, tmp_path):
    with pytest.raises(ConfigError, match=r"source=rerender needs from=<folder>: a dataset with raw states"):
        compose("collect", [*SCENE, "source=rerender"])
    given = ["source=rerender", f"from={at_level_0}"]
    with pytest.raises(ConfigError, match=r"recorded with task=PickCube, and task=StackCube was requested"):
        collected(tmp_path / "a", *given, "task=StackCube", "num_demos=2")
    with pytest.raises(ConfigError, match=r"with no task_kwargs, and task_kwargs\.variant=lift was"):
        collected(tmp_path / "b", *given, "task_kwargs.variant=lift", "num_demos=2")
    with pytest.raises(DatasetError, match=r"There is no dataset in"):
        collected(tmp_path / "d", "source=rerender", f"from={tmp_path}", "num_demos=2")
    assert not any((tmp_path / name).exists() for name in "abd")


@pytest.mark.slow
def test_a_dataset_with_several_looks_is_not_rendered_again(at_level_0, tmp_path):
    collected(tmp_path / "again", "num_demos=3", "source=rerender", f"from={at_level_0}")
    merged = merge([at_level_0, tmp_path / "again"], tmp_path / "merged").root
    looks = [facts.get("source_episode") for facts in DatasetInfo.open(merged).episode_metadata]
    assert looks == [None, None, TRAIN[0]]  # the first looks are the episodes that were there
