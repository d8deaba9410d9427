import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from envs.core.errors import ConfigError, DatasetError, RoboVerseError
from roboverse_learn.data import CollectionConfig, DatasetInfo, DatasetWriter, collect, dataset_hash
from roboverse_learn.data.collection.schedule import TooFewSuccessesError
from roboverse_learn.data.dataset.merge import merge
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode

HERE = Path(__file__).parents[1]
SOURCE = "synthetic_episodes:make_source"


@pytest.fixture(autouse=True)
def _importable_source(monkeypatch):
    monkeypatch.syspath_prepend(HERE)


def config(root, num_episodes=9, num_workers=1, candidates=range(100, 140), settings=None, **source_kwargs):
    return CollectionConfig(
        root=root,
        num_episodes=num_episodes,
        candidates=list(candidates),
        source=source_kwargs.pop("source", SOURCE),
        source_kwargs=source_kwargs,
        fps=FPS,
        features=FEATURES,
        robot_type="franka",
        num_workers=num_workers,
        settings={"task": "PickCube"} if settings is None else settings,
    )


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """What one process collects in one run."""
    root = tmp_path_factory.mktemp("undisturbed") / "d"
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(HERE)
        return collect(config(root))


def test_successes_are_kept_in_the_order_of_the_candidates(undisturbed):
    info = DatasetInfo.open(undisturbed.root)
    # 100, 104, 108 are failures of the synthetic expert.
    expected = [101, 102, 103, 105, 106, 107, 109, 110, 111]
    assert [metadata["episode"] for metadata in info.episode_metadata] == expected
    assert (undisturbed.num_episodes, undisturbed.num_attempts) == (9, 12)
    assert undisturbed.success_rate == 9 / 12
    assert undisturbed.dataset_hash == dataset_hash(undisturbed.root)


@pytest.mark.parametrize(("num_workers", "lookahead"), [(2, 1), (3, 3)])
def test_the_dataset_does_not_depend_on_the_workers(undisturbed, tmp_path, num_workers, lookahead):
    summary = collect(config(tmp_path / "d", num_workers=num_workers, lookahead=lookahead))
    assert summary.dataset_hash == undisturbed.dataset_hash
    assert (summary.num_attempts, summary.num_episodes) == (12, 9)
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == [
        ".lock",
        "data",
        "meta",
        "raw",
        "videos",
    ]


def test_progress_is_reported(tmp_path):
    seen = []
    collect(config(tmp_path / "d", num_episodes=3), seen.append)
    assert [progress.num_attempts for progress in seen] == list(range(len(seen)))
    assert seen[-1].num_episodes == seen[-1].target == 3
    assert seen[-1].num_frames == DatasetInfo.open(tmp_path / "d").num_frames
    assert seen[-1].success_rate == 3 / seen[-1].num_attempts
    assert seen[-1].frames_per_s > 0


def test_a_finished_dataset_grows(undisturbed, tmp_path):
    collect(config(tmp_path / "d", num_episodes=4))
    summary = collect(config(tmp_path / "d", num_episodes=9, num_workers=2))
    assert summary.dataset_hash == undisturbed.dataset_hash
    assert collect(config(tmp_path / "d")).dataset_hash == undisturbed.dataset_hash


def test_other_settings_are_refused(tmp_path):
    collect(config(tmp_path / "d", num_episodes=1))
    with pytest.raises(DatasetError, match="was begun with task='PickCube'; now given: task='StackCube'"):
        collect(config(tmp_path / "d", settings={"task": "StackCube"}))


def test_too_few_candidates(tmp_path):
    with pytest.raises(
        DatasetError, match=r"The 4 candidate episodes gave 3 successes; 9 were asked for\. num_demos=3 "
    ):
        collect(config(tmp_path / "d", candidates=range(100, 104)))
    assert DatasetInfo.open(tmp_path / "d").num_episodes == 3


@pytest.mark.parametrize("num_workers", [1, 2])
def test_without_a_success_it_ends_and_a_better_demonstrator_goes_on(tmp_path, num_workers):
    hopeless = config(tmp_path / "d", num_workers=num_workers, fail_every=1)
    with pytest.raises(TooFewSuccessesError, match=r"None of the 6 episodes that were tried succeeded\."):
        collect(replace(hopeless, give_up_after=6))
    summary = collect(config(tmp_path / "d", num_workers=num_workers))
    assert summary.num_episodes == 9
    assert summary.num_attempts >= 6 + 9


@pytest.mark.parametrize("num_workers", [1, 2])
def test_errors_of_a_source_reach_the_user(tmp_path, num_workers):
    with pytest.raises(RoboVerseError, match="Did you mean 'PickCube'"):
        collect(
            config(tmp_path / "d", num_workers=num_workers, source="synthetic_episodes:make_broken_source")
        )


def test_a_source_must_yield_what_it_takes(tmp_path):
    source = "synthetic_episodes:make_forgetful_source"
    with pytest.raises(
        DatasetError, match=r"took the pool episodes \[100, 102, 104, 106, 108\] and never yielded"
    ):
        collect(config(tmp_path / "d", source=source))


@pytest.mark.parametrize("slow_at", [-1, 100])
def test_a_worker_names_the_episodes_that_it_took_itself(tmp_path, slow_at):
    """Which worker gets episode 100, and which one is heard first, is the operating system's affair."""
    source = "synthetic_episodes:make_forgetful_source"
    with pytest.raises(DatasetError, match=r"and never yielded them. \(collection worker \d\)") as caught:
        collect(config(tmp_path / "d", num_workers=2, source=source, slow_at=slow_at))
    named = json.loads(re.search(r"\[.*?\]", str(caught.value))[0])
    assert named == sorted(named)
    assert set(named) <= set(range(100, 109))  # the nine that were handed out
    if slow_at == 100:  # the other worker took all the rest before this one woke up
        assert named == [101, 103, 105, 107]


def test_a_source_that_does_not_exist(tmp_path):
    with pytest.raises(DatasetError, match=r"No episode source 'nowhere:make'.*package.module:function"):
        collect(config(tmp_path / "d", source="nowhere:make"))


def test_a_dead_worker_is_named_and_the_rest_is_kept(undisturbed, tmp_path):
    root = tmp_path / "d"
    with pytest.raises(DatasetError, match=r"worker \d died \(exit code -9; out of memory\?\)"):
        collect(config(root, num_workers=2, lookahead=1, delay_s=0.05, die_at=106))
    kept = [metadata["episode"] for metadata in DatasetInfo.open(root).episode_metadata]
    # The other worker's episode was in flight, whichever it was; those after it wait for it.
    assert kept == [101, 102, 103, 105][: len(kept)]
    assert collect(config(root)).dataset_hash == undisturbed.dataset_hash


def test_impossible_numbers():
    with pytest.raises(ConfigError, match="at least 1, given 0 and 1"):
        config("d", num_episodes=0)
    with pytest.raises(ConfigError, match="name a pool episode twice"):
        config("d", candidates=[1, 1])


COLLECT = """
import json, sys
from roboverse_learn.data import CollectionConfig, collect
from synthetic_episodes import FEATURES, FPS
given = json.loads(sys.argv[1])
done = collect(CollectionConfig(fps=FPS, features=FEATURES, robot_type="franka", **given))
print(json.dumps({"hash": done.dataset_hash, "episodes": done.num_episodes, "attempts": done.num_attempts}))
"""


@pytest.mark.parametrize("num_workers", [1, 2])
def test_killed_at_any_moment_and_resumed(tmp_path, undisturbed, open_with_lerobot, num_workers):
    root, rng = tmp_path / "d", random.Random(num_workers)
    given = {
        "root": str(root),
        "num_episodes": 9,
        "candidates": list(range(100, 140)),
        "source": SOURCE,
        "source_kwargs": {"delay_s": 0.03},
        "num_workers": num_workers,
        "settings": {"task": "PickCube"},
    }
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    episodes = 0
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", COLLECT, json.dumps(given)], env=environment)
        wait_for_more(root, episodes, process)
        time.sleep(rng.uniform(0, 0.15))
        process.send_signal(signal.SIGKILL)
        process.wait()
        if not (root / "meta/info.json").exists():
            continue
        listed = json.loads((root / "meta/info.json").read_text())["total_episodes"]
        assert listed >= episodes
        episodes = listed
        if episodes:
            dataset = open_with_lerobot(root)
            assert dataset.num_episodes == episodes
            assert dataset[len(dataset) - 1]["observation.images.front"].shape == (3, 32, 32)
    assert episodes > 0
    assert collect(config(root)).dataset_hash == undisturbed.dataset_hash


def wait_for_more(root, episodes, process, timeout_s=30):
    """Waits until a collection has committed one more episode, or has ended."""
    deadline = time.monotonic() + timeout_s
    info = root / "meta/info.json"
    while time.monotonic() < deadline and process.poll() is None:
        if info.exists() and json.loads(info.read_text())["total_episodes"] > episodes:
            return
        time.sleep(0.02)


def test_two_collections_at_once_share_one_dataset(tmp_path, undisturbed):
    """The second waits for the first, finds everything there, and collects nothing again."""
    root = tmp_path / "d"
    given = {"root": str(root), "num_episodes": 9, "candidates": list(range(100, 140)), "source": SOURCE}
    given |= {"source_kwargs": {"delay_s": 0.02}, "settings": {"task": "PickCube"}}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    command = [sys.executable, "-c", COLLECT, json.dumps(given)]
    other = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    wait_for_more(root, 0, other)
    assert other.poll() is None
    seen = []
    here = collect(config(root), seen.append)
    there = json.loads(other.communicate(timeout=60)[0])
    assert there == {"hash": undisturbed.dataset_hash, "episodes": 9, "attempts": 12}
    assert here.dataset_hash == undisturbed.dataset_hash
    assert (here.num_episodes, here.num_attempts, len(seen)) == (9, 12, 1)


def test_who_waits_says_so(tmp_path, caplog):
    """The lock is the process's: a thread of ours that holds it makes a collection wait as another would."""
    root = tmp_path / "d"
    writer = DatasetWriter(root, fps=FPS, features=FEATURES, robot_type="franka")
    with caplog.at_level("INFO"), ThreadPoolExecutor(1) as pool:
        collected = pool.submit(collect, config(root, num_episodes=2))
        deadline = time.monotonic() + 30
        while "Another process is writing" not in caplog.text and time.monotonic() < deadline:
            time.sleep(0.01)
        waiting = not collected.done()
        writer.close()  # whatever is wrong: a thread that waits would hold up the end of the tests
        assert waiting and f"writing the dataset '{root}'; waiting until it has finished" in caplog.text
        assert collected.result(timeout=60).num_episodes == 2


class TestMerge:
    def write(self, root, indices):
        with DatasetWriter(root, fps=FPS, features=FEATURES, robot_type="franka") as writer:
            for index in indices:
                writer.add_episode(make_episode(index, task=f"task {index % 2}"))
        return root

    def test_the_result_does_not_depend_on_the_parts(self, tmp_path, open_with_lerobot):
        whole = self.write(tmp_path / "whole", range(6))
        odd, even = self.write(tmp_path / "odd", [5, 1, 3]), self.write(tmp_path / "even", [4, 0, 2])
        merged = merge([odd, even], tmp_path / "merged")
        assert dataset_hash(merged.root) == dataset_hash(whole)
        assert (merged.root / "meta/stats.json").read_text() == (whole / "meta/stats.json").read_text()
        dataset = open_with_lerobot(merged.root)
        assert [int(dataset[i]["index"]) for i in range(len(dataset))] == list(range(merged.num_frames))

    def test_a_killed_merge_is_completed(self, tmp_path, monkeypatch):
        parts = [self.write(tmp_path / "odd", [1, 3]), self.write(tmp_path / "even", [0, 2])]
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
        whole = self.write(tmp_path / "whole", range(4))
        assert dataset_hash(tmp_path / "merged") == dataset_hash(whole)

    def test_lerobot_aggregates_ours(self, tmp_path, open_with_lerobot):
        from lerobot.datasets import aggregate_datasets

        parts = [self.write(tmp_path / "a", [0, 1]), self.write(tmp_path / "b", [2, 3])]
        aggregate_datasets(["l/a", "l/b"], "l/c", roots=parts, aggr_root=tmp_path / "c")
        dataset = open_with_lerobot(tmp_path / "c")
        assert dataset.num_episodes == 4
        np.testing.assert_array_equal(
            dataset[len(dataset) - 1]["observation.state"], make_episode(3).states[-1]
        )

    def test_sources_of_another_kind(self, tmp_path):
        episode = make_episode(0)
        del episode.metadata["episode"]
        with DatasetWriter(tmp_path / "a", fps=FPS, features=FEATURES) as writer:
            writer.add_episode(episode)
        with pytest.raises(DatasetError, match=r"without a pool index.*aggregate_datasets"):
            merge([tmp_path / "a"], tmp_path / "b")
        with pytest.raises(DatasetError, match="Nothing to merge"):
            merge([], tmp_path / "b")
