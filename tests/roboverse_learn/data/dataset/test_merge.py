from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

from envs.core.atomic import write_json
from envs.core.errors import DatasetError
from roboverse_learn import cli
from roboverse_learn.data import DatasetInfo, DatasetWriter, dataset_hash
from roboverse_learn.data.collection.schedule import Schedule
from roboverse_learn.data.dataset import raw
from roboverse_learn.data.dataset.info import is_collected_here
from roboverse_learn.data.dataset.merge import merge
from roboverse_learn.data.dataset.schema import COLLECTION_PATH
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode


def write(root, indices, **facts):
    with DatasetWriter(root, fps=FPS, features=FEATURES, robot_type="franka") as writer:
        for index in indices:
            episode = make_episode(index, task=f"task {index % 2}")
            episode.metadata |= facts
            writer.add_episode(episode)
    return root


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_parts(tmp_path, open_with_lerobot):
    whole = write(tmp_path / "whole", range(6))
    odd, even = write(tmp_path / "odd", [5, 1, 3]), write(tmp_path / "even", [4, 0, 2])
    merged = merge([odd, even], tmp_path / "merged")
    assert dataset_hash(merged.root) == dataset_hash(whole)
    assert (merged.root / "meta/stats.json").read_text() == (whole / "meta/stats.json").read_text()
    dataset = open_with_lerobot(merged.root)
    assert [int(dataset[i]["index"]) for i in range(len(dataset))] == list(range(merged.num_frames))


@pytest.mark.parametrize(
    "facts",
    [
        {"simulator": "sapien"},
        {"simulator_settings": {"njmax": 768}},
        {"robot": "iiwa"},
        {"renderer": "gl"},
        {"task_kwargs": {"variant": "lift"}},
        {"scenario": {"room": None}},
        {"steps_per_look": 1},
        {"source": "teleop", "file_sha256": "5e"},
        {"source": "policy", "policy": "ppo", "weights": "7a"},
    ],
    ids=lambda facts: next(iter(facts)),
)
def test_episodes_of_one_index_and_another_environment_or_demonstrator_are_all_kept(tmp_path, facts):
    usual = {"simulator": "mujoco", "renderer": "warp", "task_kwargs": {}}
    parts = [write(tmp_path / "a", [0, 1], **usual), write(tmp_path / "b", [1, 0], **(usual | facts))]
    for order, out in ((parts, "ab"), (parts[::-1], "ba"), ([*parts, *parts], "ab")):
        assert merge(order, tmp_path / out).num_episodes == 4
    assert dataset_hash(tmp_path / "ab") == dataset_hash(tmp_path / "ba")


def test_a_killed_merge_is_completed(tmp_path, monkeypatch):
    parts = [write(tmp_path / "odd", [1, 3]), write(tmp_path / "even", [0, 2])]
    commit, calls = DatasetWriter.commit, iter(range(9))

    def killed(self, staged):
        if next(calls) == 2:
            raise KeyboardInterrupt
        return commit(self, staged)

    monkeypatch.setattr(DatasetWriter, "commit", killed)
    with pytest.raises(KeyboardInterrupt):
        merge(parts, tmp_path / "merged")
    assert DatasetInfo.open(tmp_path / "merged").num_episodes == 2
    merge(parts, tmp_path / "merged")
    merge(parts, tmp_path / "merged")
    whole = write(tmp_path / "whole", range(4))
    assert dataset_hash(tmp_path / "merged") == dataset_hash(whole)


CAMERA = "observation.images.front"


@pytest.mark.parametrize(
    ("fps", "changed", "said"),
    [
        (30, {}, "20 and 30 fps"),
        (20, {CAMERA: None}, f"{CAMERA} in the first alone"),
        (20, {"more": {"dtype": "float32", "shape": (1,), "names": None}}, "more in the second alone"),
        (20, {CAMERA: {"shape": (3, 9, 9)}}, rf"{CAMERA} of shape \(.*\) and \(3, 9, 9\)"),
        (20, {"action": {"names": ["elbow"]}}, r'action of float32 \[.*\] and float32 \["elbow"\]'),
    ],
)
def test_datasets_that_differ_are_refused_and_what_differs_is_named(
    fps, changed, said, monkeypatch, tmp_path
):
    first, other = (DatasetInfo.open(write(tmp_path / name, [k])) for k, name in enumerate(("a", "b")))
    features = {key: dict(value) for key, value in FEATURES.items()}
    for key, change in changed.items():
        features[key] = None if change is None else features.get(key, {}) | change
    features = {key: feature for key, feature in features.items() if feature is not None}
    other = replace(other, fps=fps, features=features)
    monkeypatch.setattr(DatasetInfo, "open", {first.root: first, other.root: other}.get)
    with pytest.raises(DatasetError, match=rf"'{first.root}' and '{other.root}' have {said}\. Merge only"):
        merge([first.root, other.root], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


@pytest.mark.parametrize("kept", [None, 0, 0.5])
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("raw/episode_000001.safetensors", "no raw states of episode 1"),
        ("videos/observation.images.front/chunk-000/file-001.mp4", "is missing"),
    ],
)
def test_a_part_whose_file_is_missing_or_cut_is_named_before_anything_is_written(tmp_path, name, said, kept):
    whole, part = write(tmp_path / "whole", [0]), write(tmp_path / "part", [1, 2])
    content = (part / name).read_bytes()
    (part / name).unlink()
    if kept is not None:
        (part / name).write_bytes(content[: int(kept * len(content))])
        said = f"'{part / name}' is truncated or damaged"
    with pytest.raises(DatasetError, match=said):
        merge([whole, part], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_raw_states_are_checked_without_reading_them(tmp_path, monkeypatch):
    part = write(tmp_path / "part", [1, 2])
    monkeypatch.setattr(raw, "read_tensors", None)
    assert merge([part], tmp_path / "merged").num_episodes == 2
    path = part / "raw/episode_000001.safetensors"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(DatasetError, match=f"'{path}' is truncated or damaged"):
        merge([part], tmp_path / "other")


def collected(root, indices):
    """Writes a dataset with the record of its collection, and a failed candidate."""
    write(root, indices, level=0)
    write_json(root / COLLECTION_PATH, {"settings": {"level": 0}, "failed": [9]})
    return root


def test_a_dataset_that_was_merged_into_is_of_no_collection(tmp_path):
    root, other = collected(tmp_path / "collected", [0, 1]), write(tmp_path / "other", [0, 1], level=3)
    merge([root], root)
    assert is_collected_here(root), "nothing was added"
    assert merge([other], root).num_episodes == 4
    assert not is_collected_here(root)
    with (
        DatasetWriter(root, fps=FPS, features=FEATURES) as writer,
        pytest.raises(DatasetError, match="not collected there"),
    ):
        Schedule(writer, [0, 1], 2, {"level": 0})
    assert not is_collected_here(root)


def test_a_merge_into_a_collection_that_is_killed_leaves_a_dataset_of_no_collection(tmp_path, monkeypatch):
    root, other = collected(tmp_path / "collected", [0, 1]), write(tmp_path / "other", [2], level=3)
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(DatasetWriter, "commit", mock.Mock(side_effect=KeyboardInterrupt))
        merge([other], root)
    assert DatasetInfo.open(root).num_episodes == 2 and not is_collected_here(root)
    assert merge([other], root).num_episodes == 3


@pytest.mark.slow
def test_lerobot_aggregates_ours(tmp_path, open_with_lerobot):
    from lerobot.datasets import aggregate_datasets

    parts = [write(tmp_path / "a", [0, 1]), write(tmp_path / "b", [2, 3])]
    aggregate_datasets(["l/a", "l/b"], "l/c", roots=parts, aggr_root=tmp_path / "c")
    dataset = open_with_lerobot(tmp_path / "c")
    assert dataset.num_episodes == 4
    np.testing.assert_array_equal(dataset[len(dataset) - 1]["observation.state"], make_episode(3).states[-1])


def test_sources_of_another_kind(tmp_path):
    episode = make_episode(0)
    del episode.metadata["episode"]
    with DatasetWriter(tmp_path / "a", fps=FPS, features=FEATURES) as writer:
        writer.add_episode(episode)
    with pytest.raises(DatasetError, match=r"without a pool index.*aggregate_datasets"):
        merge([tmp_path / "a"], tmp_path / "b")
    with pytest.raises(DatasetError, match="Nothing to merge"):
        merge([], tmp_path / "b")


@pytest.mark.slow
def test_commands_merge_and_describe(tmp_path, capsys):
    whole = write(tmp_path / "whole", range(4))
    parts = [write(tmp_path / "a", [3, 1]), write(tmp_path / "b", [2, 0])]
    words = [f"out={tmp_path}/merged", f"from=[{parts[0]},{parts[1]}]"]
    assert cli.main(["dataset", "merge", *words]) == 0
    said = capsys.readouterr().out
    assert f"4 episodes, {DatasetInfo.open(whole).num_frames} frames" in said and "left out" not in said
    (tmp_path / "named-variant=lift").symlink_to(tmp_path / "merged")
    for named in (f"dataset={tmp_path}/merged", f"{tmp_path}/merged", f"{tmp_path}/named-variant=lift"):
        assert cli.main(["dataset", "info", named]) == 0
        assert f"hash {dataset_hash(whole)[:16]}" in capsys.readouterr().out
    for wrong, says in (
        (["merge", "out=x"], "needs from=[<folder>,<folder>] and out=<folder>"),
        (["info"], "needs dataset=<folder>"),
        (["merg"], "Did you mean 'merge'?"),
        (["info", f"dataset={tmp_path}/none"], "none"),
    ):
        assert cli.main(["dataset", *wrong]) == 2
        assert says in capsys.readouterr().err


def test_the_command_says_how_many_episodes_were_left_out(tmp_path, capsys):
    parts = [write(tmp_path / "a", [0, 1, 2]), write(tmp_path / "b", [2, 3])]
    assert cli.main(["dataset", "merge", f"out={tmp_path}/merged", f"from=[{parts[0]},{parts[1]}]"]) == 0
    said = capsys.readouterr().out
    assert "4 episodes" in said and "left out: 1 of the 5 episodes given" in said and "added" not in said


def test_the_command_says_that_the_dataset_was_there_before(tmp_path, capsys):
    write(tmp_path / "a", [0, 1])
    write(tmp_path / "b", [1, 2, 3])
    assert cli.main(["dataset", "merge", f"out={tmp_path}/a", f"from=[{tmp_path}/b]"]) == 0
    said = capsys.readouterr().out
    assert "4 episodes" in said and "added: 2 episodes to the 2 that were there" in said
    assert "left out: 1 of the 3 episodes given" in said


def test_the_command_counts_a_source_that_is_merged_into_as_it_was_before(tmp_path, capsys):
    into, other = write(tmp_path / "into", [0, 1]), write(tmp_path / "other", [2, 3, 4])
    assert cli.main(["dataset", "merge", f"out={into}", f"from=[{into},{other}]"]) == 0
    said = capsys.readouterr().out
    assert "5 episodes" in said and "added: 3 episodes to the 2 that were there" in said
    assert "left out: 2 of the 5 episodes given" in said


@pytest.mark.parametrize("kept", [0, 200])
def test_a_damaged_video_is_named_and_ends_the_command_with_code_1(tmp_path, capsys, kept):
    root = write(tmp_path / "d", range(3))
    video = DatasetInfo.open(root).video_file(1, "observation.images.front")
    video.write_bytes(video.read_bytes()[:kept])
    assert cli.main(["dataset", "info", f"dataset={root}"]) == 1
    said = capsys.readouterr().out
    assert "3 episodes" in said and "1 of its videos is damaged" in said and "hash" not in said
    assert f"damaged: '{video}' is truncated or damaged (Invalid data found" in said
    assert "Restore it from a copy, or delete the dataset's folder and collect it again." in said
