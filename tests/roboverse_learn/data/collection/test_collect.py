import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from envs.core.errors import ConfigError, DatasetError, RoboVerseError
from roboverse_learn.data import CollectionConfig, DatasetInfo, DatasetWriter, collect, dataset_hash
from roboverse_learn.data.collection.schedule import TooFewSuccessesError
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS
from tests.sweeps import sweep

pytestmark = pytest.mark.slow

HERE = Path(__file__).parents[1]
SOURCE = "synthetic_episodes:SyntheticSource"


@pytest.fixture(autouse=True)
def _importable_source(monkeypatch):
    monkeypatch.syspath_prepend(HERE)


def config(root, num_episodes=9, num_workers=1, candidates=range(100, 140), settings=None, **source_kwargs):
    """Settings of a collection; other arguments are the source's."""
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
        batch_size=source_kwargs.pop("batch_size", 2),
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


@pytest.mark.parametrize(("num_workers", "batch_size"), [(2, 1), (3, 3)])
def test_the_dataset_does_not_depend_on_the_workers(undisturbed, tmp_path, num_workers, batch_size):
    summary = collect(config(tmp_path / "d", num_workers=num_workers, batch_size=batch_size))
    assert summary.dataset_hash == undisturbed.dataset_hash
    assert (summary.num_attempts, summary.num_episodes) == (12, 9)
    assert sorted(path.name for path in (tmp_path / "d").iterdir()) == [
        ".lock",
        "data",
        "meta",
        "raw",
        "videos",
    ]


def test_the_dataset_does_not_depend_on_the_processes_that_encode(undisturbed, tmp_path):
    summary = collect(replace(config(tmp_path / "d"), num_encoders=2))
    assert summary.dataset_hash == undisturbed.dataset_hash
    assert [path.name for path in (tmp_path / "d").glob(".*")] == [".lock"]


def test_progress_is_reported(tmp_path):
    seen = []
    collect(config(tmp_path / "d", num_episodes=3), seen.append)
    assert seen[0].num_attempts == 0
    tried = [progress.num_attempts for progress in seen]
    assert tried == sorted(set(tried))
    assert seen[-1].num_episodes == seen[-1].target == 3
    assert seen[-1].num_frames == DatasetInfo.open(tmp_path / "d").num_frames
    assert seen[-1].success_rate == 3 / seen[-1].num_attempts
    assert seen[-1].frames_per_s > 0


def test_a_finished_dataset_grows(undisturbed, tmp_path):
    collect(config(tmp_path / "d", num_episodes=4))
    summary = collect(config(tmp_path / "d", num_episodes=9, num_workers=2))
    assert summary.dataset_hash == undisturbed.dataset_hash
    assert collect(config(tmp_path / "d")).dataset_hash == undisturbed.dataset_hash


@pytest.mark.parametrize("num_episodes", [3, 4])
def test_a_damaged_video_is_refused_before_anything_is_collected(tmp_path, num_episodes):
    collect(config(tmp_path / "d", num_episodes=3))
    info = DatasetInfo.open(tmp_path / "d")
    first, second = (info.video_file(index, "observation.images.front") for index in (0, 1))
    second.write_bytes(second.read_bytes()[:200])
    named = rf"{second.name}' is truncated or damaged \(Invalid.*Restore it from a copy, or delete.* again\.$"
    with pytest.raises(DatasetError, match=named):
        collect(config(tmp_path / "d", num_episodes=num_episodes))
    first.write_bytes(b"")
    with pytest.raises(DatasetError, match=rf"{first.name}'.*2 videos are damaged: roboverse dataset info"):
        collect(config(tmp_path / "d", num_episodes=num_episodes))
    assert DatasetInfo.open(tmp_path / "d").num_episodes == 3


def test_raw_states_that_are_missing_are_refused_before_anything_is_collected(tmp_path):
    collect(config(tmp_path / "d", num_episodes=3))
    info = DatasetInfo.open(tmp_path / "d")
    missing = info.raw_file(1)
    whole = missing.read_bytes()
    missing.unlink()
    with pytest.raises(DatasetError, match=rf"{missing.name}' is missing, and other episodes have theirs"):
        collect(config(tmp_path / "d", num_episodes=5))
    missing.write_bytes(whole[:-100])
    with pytest.raises(DatasetError, match=rf"{missing.name}' is truncated or damaged"):
        collect(config(tmp_path / "d", num_episodes=5))
    shutil.rmtree(missing.parent)
    first = info.raw_file(0).name
    with pytest.raises(DatasetError, match=rf"{first}' is missing, as is that of every episode\. Restore it"):
        collect(config(tmp_path / "d", num_episodes=5))
    assert DatasetInfo.open(tmp_path / "d").num_episodes == 3


def test_other_settings_are_refused(tmp_path):
    collect(config(tmp_path / "d", num_episodes=1))
    with pytest.raises(DatasetError, match="was begun with task='PickCube'; now given: task='StackCube'"):
        collect(config(tmp_path / "d", settings={"task": "StackCube"}))


def test_too_few_candidates(tmp_path):
    with pytest.raises(
        DatasetError, match=r"The 4 candidate episodes gave 3 successes; 9 are needed\. num_demos=3 "
    ):
        collect(config(tmp_path / "d", candidates=range(100, 104)))
    assert DatasetInfo.open(tmp_path / "d").num_episodes == 3


@pytest.mark.parametrize("num_workers", [1, 2])
def test_without_success_it_ends_and_a_better_demonstrator_resumes(tmp_path, num_workers):
    hopeless = config(tmp_path / "d", num_workers=num_workers, fail_every=1)
    with pytest.raises(TooFewSuccessesError, match=r"None of the 6 episodes that were tried succeeded\."):
        collect(replace(hopeless, give_up_after=6))
    summary = collect(config(tmp_path / "d", num_workers=num_workers))
    assert summary.num_episodes == 9
    assert summary.num_attempts >= 6 + 9


@pytest.mark.parametrize("num_workers", [1, 2])
def test_errors_of_a_source_reach_the_user(tmp_path, num_workers):
    for source, says in (
        ("synthetic_episodes:BrokenSource", "Did you mean 'PickCube'"),
        ("synthetic_episodes:ForgetfulSource", r"took the pool episodes \[101\] and never yielded"),
        ("nowhere:make", r"No episode source 'nowhere:make'.*package.module:Class"),
    ):
        with pytest.raises(RoboVerseError, match=says) as caught:
            collect(
                config(tmp_path / "d", num_workers=num_workers, candidates=range(100, 104), source=source)
            )
        assert ("(collection worker " in str(caught.value)) == (num_workers == 2)


@pytest.mark.parametrize("num_workers", [1, 2])
def test_a_collection_that_fails_at_once_leaves_nothing(tmp_path, num_workers):
    root, users = tmp_path / "d", tmp_path / "users"
    users.mkdir()
    for folder in (root, users):
        with pytest.raises(RoboVerseError, match="PickCub"):
            collect(config(folder, num_workers=num_workers, source="synthetic_episodes:BrokenSource"))
    assert not root.exists() and [path.name for path in users.iterdir()] == [".lock"]
    assert collect(config(root, 1, settings={"task": "StackCube"})).num_episodes == 1


def test_failures_alone_do_not_hold_a_dataset_to_their_settings(tmp_path):
    failing = {"candidates": range(100), "source": "synthetic_episodes:SyntheticSource", "fail_every": 1}
    with pytest.raises(TooFewSuccessesError):
        collect(config(tmp_path / "d", **failing))
    other = replace(config(tmp_path / "d", 1, settings={"task": "StackCube"}), fps=FPS + 1)
    assert collect(other).num_episodes == 1
    assert DatasetInfo.open(tmp_path / "d").fps == FPS + 1


def test_dead_worker_is_named_and_committed_episodes_stay(undisturbed, tmp_path):
    root = tmp_path / "d"
    with pytest.raises(DatasetError, match=r"worker died \(exit code 9; out of memory\?\)"):
        collect(config(root, num_workers=2, batch_size=1, delay_s=0.05, die_at=106))
    kept = [metadata["episode"] for metadata in DatasetInfo.open(root).episode_metadata]
    assert kept == [101, 102, 103, 105][: len(kept)]
    assert collect(config(root)).dataset_hash == undisturbed.dataset_hash


def test_impossible_numbers():
    with pytest.raises(ConfigError, match="num_episodes must be at least 1, given 0"):
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


@pytest.mark.parametrize("seed", sweep(range(17), always=[1]))
def test_killed_at_any_moment_and_resumed(tmp_path, undisturbed, open_with_lerobot, seed):
    """Of all seeds, 51 kills."""
    root, rng, num_workers = tmp_path / "d", random.Random(seed), 1 + seed % 2
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
    episodes, ends = 0, []
    for _ in range(3):
        process = subprocess.Popen([sys.executable, "-c", COLLECT, json.dumps(given)], env=environment)
        wait_for_more(root, episodes, process)
        time.sleep(rng.uniform(0, 0.15))
        process.send_signal(signal.SIGKILL)
        ends.append(process.wait())
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
    # Not only after the last episode. One process commits several together, and may end before the kill.
    assert -signal.SIGKILL in ends or num_workers == 1
    assert collect(config(root)).dataset_hash == undisturbed.dataset_hash


def children_of(pid):
    tasks = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in tasks.read_text().split()]


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="reads /proc")
@pytest.mark.parametrize(("sent", "ends"), [(signal.SIGKILL, -9), (signal.SIGINT, -2)])
def test_workers_end_with_their_parent(tmp_path, sent, ends):
    given = {
        "root": str(tmp_path / "d"),
        "num_episodes": 9,
        "candidates": list(range(100, 140)),
        "source": SOURCE,
        "source_kwargs": {"delay_s": 60.0},
        "num_workers": 2,
    }
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(HERE), *sys.path])}
    command = [sys.executable, "-c", COLLECT, json.dumps(given)]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, start_new_session=True)
    logs = tmp_path / "d/.staging"
    wait_until(lambda: len(list(logs.glob("worker_*.log"))) == 2)
    children = children_of(process.pid)
    assert len(children) >= 2
    os.killpg(process.pid, sent) if sent == signal.SIGINT else process.send_signal(sent)
    printed = process.communicate(timeout=20)[1]
    assert process.returncode == ends
    assert printed.count(b"KeyboardInterrupt") == (sent == signal.SIGINT)
    wait_until(lambda: not any(running(child) for child in children))


def wait_until(holds, timeout_s=30):
    deadline = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


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


def test_a_collection_that_waits_reports_it(tmp_path, caplog):
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
        assert waiting and f"writing to '{root}'; waiting until it has finished" in caplog.text
        assert collected.result(timeout=60).num_episodes == 2
