"""What a kill can leave on the disk: every state on the way of one episode, opened by LeRobot and by us."""

import json
import os
import shutil

import numpy as np
import pytest

from envs.core.atomic import PARTIAL, link_file, write_file, write_json
from envs.core.errors import DatasetError, WriteError
from roboverse_learn.data import DatasetInfo, DatasetWriter, ResidentDataset, dataset_hash, recover
from roboverse_learn.data.dataset import tables
from roboverse_learn.data.dataset.damage import read_json
from roboverse_learn.data.dataset.staging import stage_episode
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode

CAMERA = "observation.images.front"


def episode(index):
    """The third episode brings a new instruction, so that its commit touches every file there is."""
    return make_episode(index, task="lift the cube" if index < 2 else "push the cube")


def write(root, indices):
    with DatasetWriter(root, fps=FPS, features=FEATURES) as writer:
        for index in indices:
            writer.add_episode(episode(index))
    return root


class Snapshots:
    """Copies a folder before and after every rename, as kills at these moments would leave it."""

    def __init__(self, root, folder):
        self.root, self.folder, self.renamed = root, folder, []

    def rename(self, real):
        def renamed(source, target):
            self.copy("before", target)
            real(source, target)
            self.copy("after", target)

        return renamed

    def copy(self, when, target):
        number = len(self.renamed)
        self.renamed.append(os.path.basename(target))
        shutil.copytree(self.root, self.folder / f"{number:02d}_{when}_{os.path.basename(target)}")


@pytest.fixture(scope="module")
def states(tmp_path_factory):
    """Folders, in order, of everything that committing a third episode leaves on the way."""
    folder = tmp_path_factory.mktemp("states")
    root = write(tmp_path_factory.mktemp("dataset") / "d", range(2))
    snapshots = Snapshots(root, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", snapshots.rename(os.replace))
        patch.setattr(os, "rename", snapshots.rename(os.rename))
        write(root, [2])
    return sorted(folder.iterdir())


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    return write(tmp_path_factory.mktemp("undisturbed") / "d", range(3))


def test_a_commit_is_the_renames_that_the_writer_documents(states):
    after = [path.name.split("_after_")[1] for path in states if "_after_" in path.name]
    staged = [f"{CAMERA}.mp4", "raw.safetensors", "numbers.safetensors", "writer_000002"]
    commit = ["file-002.mp4", "episode_000002.safetensors", "tasks.parquet"]
    assert after[:7] == [*staged, *commit]
    assert after[7:] == ["file-000.parquet"] * 2 + ["stats.json", "info.json", "stats.json"]


@pytest.mark.slow
def test_lerobot_opens_every_state_with_whole_episodes_only(states, open_with_lerobot):
    counts = []
    for state in states:
        dataset = open_with_lerobot(state)
        counts.append(dataset.num_episodes)
        frames = [episode(index) for index in range(dataset.num_episodes)]
        assert len(dataset) == sum(one.length for one in frames), state.name
        last = dataset[len(dataset) - 1]
        np.testing.assert_array_equal(last["observation.state"], frames[-1].states[-1], state.name)
        assert last["task"] == frames[-1].task
        assert last[CAMERA].shape == (3, 32, 32)
    assert counts == sorted(counts) and set(counts) == {2, 3}


def test_our_reader_opens_every_state(states):
    for state in states:
        resident = ResidentDataset(state)
        assert len(resident) == sum(episode(i).length for i in range(resident.info.num_episodes))
        assert len(resident.frames[CAMERA]) == len(resident)


@pytest.mark.slow
def test_every_state_is_continued_to_the_undisturbed_dataset(states, undisturbed, tmp_path):
    expected, stats = dataset_hash(undisturbed), (undisturbed / "meta/stats.json").read_bytes()
    files = sorted(path.relative_to(undisturbed) for path in undisturbed.rglob("*") if path.is_file())
    committed = []
    for state in states:
        root = shutil.copytree(state, tmp_path / state.name)
        with DatasetWriter(root, fps=FPS, features=FEATURES) as writer:
            committed.append(writer.num_episodes)
            for index in range(writer.num_episodes, 3):
                writer.add_episode(episode(index))
        shutil.rmtree(root / ".staging", ignore_errors=True)  # a finished one is kept for the collection
        assert dataset_hash(root) == expected, state.name
        assert (root / "meta/stats.json").read_bytes() == stats, state.name
        assert sorted(path.relative_to(root) for path in root.rglob("*") if path.is_file()) == files
    # The rename of the episode's row is the commit, and it is one of the renames.
    assert committed == sorted(committed) and set(committed) == {2, 3}


def test_statistics_are_of_all_episodes_also_where_no_further_one_came(states, tmp_path):
    for state in states:
        root = shutil.copytree(state, tmp_path / state.name)
        with pytest.raises(KeyboardInterrupt), DatasetWriter(root, fps=FPS, features=FEATURES):
            raise KeyboardInterrupt
        info = DatasetInfo.open(root)
        assert info.stats["action"]["count"].item() == info.num_frames, state.name


@pytest.mark.parametrize(
    "stats", [None, "", '{"action"', "{}", '{"index": {"count": [5]}}', '{"index": {"count": [null]}}']
)
@pytest.mark.parametrize("put_right", [recover, lambda root: write(root, ())], ids=["recover", "open"])
def test_statistics_that_are_lost_or_cut_are_made_again(undisturbed, tmp_path, put_right, stats):
    root = shutil.copytree(undisturbed, tmp_path / "d")
    (root / "meta/stats.json").unlink() if stats is None else (root / "meta/stats.json").write_text(stats)
    put_right(root)
    assert (root / "meta/stats.json").read_bytes() == (undisturbed / "meta/stats.json").read_bytes()


def commit_together(root, indices):
    """Commits the episodes from the dataset's own number on, all at once."""
    with DatasetWriter(root, fps=FPS, features=FEATURES) as writer:
        committed, folder = writer.num_episodes, writer.staging_directory
        shutil.rmtree(folder, ignore_errors=True)
        wanted = [index for index in indices if index >= committed]
        writer.commit(
            *(stage_episode(folder / f"pool_{i:06d}", episode(i), FPS, writer.encoder) for i in wanted)
        )
    return committed


@pytest.mark.slow
def test_a_kill_while_episodes_are_committed_together_loses_none_that_is_listed(tmp_path, monkeypatch):
    """Over the end of a file, so that two renames commit: episodes 2 and 3 in one, episode 4 in the next."""
    monkeypatch.setattr(tables, "EPISODES_PER_FILE", 2)
    (tmp_path / "states").mkdir()
    one_by_one = write(tmp_path / "one_by_one", range(5))
    root = write(tmp_path / "together", range(2))
    snapshots = Snapshots(root, tmp_path / "states")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "replace", snapshots.rename(os.replace))
        commit_together(root, range(5))
    files = {path.relative_to(root): path for path in root.rglob("*") if path.suffix in (".json", ".parquet")}
    for name, path in files.items():
        assert path.read_bytes() == (one_by_one / name).read_bytes(), name
    expected = dataset_hash(root)
    committed = []
    for state in sorted((tmp_path / "states").iterdir()):
        info = DatasetInfo.open(state)
        assert len(ResidentDataset(state)) == sum(episode(i).length for i in range(info.num_episodes))
        committed.append(commit_together(state, range(5)))
        assert dataset_hash(state) == expected, state.name
        assert committed[-1] >= info.num_episodes  # the rows are the truth, and the counts follow them
    assert committed == sorted(committed) and set(committed) == {2, 4, 5}


def test_recover_agrees_with_the_rows_in_every_state(states, undisturbed, tmp_path):
    shorter = write(tmp_path / "shorter", range(2))
    for state in states:
        root = shutil.copytree(state, tmp_path / state.name)
        total = recover(root)
        assert json.loads((root / "meta/info.json").read_text())["total_episodes"] == total
        info = DatasetInfo.open(root)
        assert info.num_frames == sum(episode(index).length for index in range(total))
        assert len(list((root / "raw").iterdir())) == total
        whole = undisturbed if total == 3 else shorter
        assert (root / "meta/stats.json").read_bytes() == (whole / "meta/stats.json").read_bytes(), state.name
        assert not list(root.rglob(f".*{PARTIAL}"))
        assert recover(root) == total, "recovering twice is recovering once"


def test_a_dataset_of_another_program_is_not_continued(tmp_path):
    import pyarrow.parquet as pq

    root = write(tmp_path / "d", range(1))
    rows = root / "meta/episodes/chunk-000/file-000.parquet"
    pq.write_table(pq.read_table(rows).drop_columns("roboverse/metadata"), rows)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    with pytest.raises(DatasetError, match=r"another program and can be read but not continued"):
        DatasetWriter(root, fps=FPS, features=FEATURES)
    assert {path: path.read_bytes() for path in before} == before
    assert len(ResidentDataset(root)) == episode(0).length


@pytest.mark.parametrize("lost", ["meta/episodes", "meta/episodes/chunk-000/file-000.parquet"])
def test_a_dataset_whose_episodes_are_no_longer_listed_is_kept(tmp_path, lost):
    root = write(tmp_path / "d", range(2))
    (shutil.rmtree if (root / lost).is_dir() else os.unlink)(root / lost)
    before = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    for opening in (recover, lambda root: DatasetWriter(root, fps=FPS, features=FEATURES)):
        with pytest.raises(DatasetError, match=r"meta/episodes' .* \(0 of 2 episodes are listed\)\. Restore"):
            opening(root)
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == before


def test_a_writer_that_could_not_open_gives_the_lock_back(tmp_path):
    root = write(tmp_path / "d", range(1))
    with pytest.raises(DatasetError, match=f"{FPS} and 7 fps"):
        DatasetWriter(root, fps=7, features=FEATURES)
    DatasetWriter(root, fps=FPS, features=FEATURES).close()


class TestFiles:
    def test_a_failed_write_leaves_the_file_as_it_was(self, tmp_path, monkeypatch):
        write_json(tmp_path / "a.json", {"x": 1})

        def failing(source, target):
            raise OSError(5, "Input/output error")

        monkeypatch.setattr(os, "replace", failing)
        with pytest.raises(OSError, match="Input/output"):
            write_json(tmp_path / "a.json", {"x": 2})
        assert read_json(tmp_path / "a.json") == {"x": 1}
        assert [path.name for path in tmp_path.iterdir()] == ["a.json"]

    def test_a_link_replaces_and_survives_its_source(self, tmp_path):
        write_file(tmp_path / "source", b"new")
        write_file(tmp_path / "deep/target", b"old")
        link_file(tmp_path / "source", tmp_path / "deep/target")
        (tmp_path / "source").unlink()
        assert (tmp_path / "deep/target").read_bytes() == b"new"

    def test_a_file_system_without_links_copies(self, tmp_path, monkeypatch):
        def no_links(source, target):
            raise OSError(95, "Operation not supported")

        monkeypatch.setattr(os, "link", no_links)
        write_file(tmp_path / "source", b"bytes")
        link_file(tmp_path / "source", tmp_path / "target")
        assert (tmp_path / "target").read_bytes() == b"bytes"
        assert (tmp_path / "target").stat().st_ino != (tmp_path / "source").stat().st_ino

    def test_a_forbidden_folder_is_named(self, tmp_path, monkeypatch):
        def forbidden(*_args, **_kwargs):
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr(os, "replace", forbidden)
        with pytest.raises(WriteError, match=r"a.json' could not be written: Permission denied"):
            write_json(tmp_path / "a.json", {})


def test_episodes_that_lost_their_description_are_refused_and_kept(tmp_path):
    root = write(tmp_path / "d", range(2))
    shutil.rmtree(root / "meta")
    before = sorted(root.rglob("*.*"))
    with pytest.raises(DatasetError, match=r"holds 'data/.*parquet' and has lost meta/info\.json\. Restore"):
        write(root, range(1))
    assert sorted(root.rglob("*.*")) == before
