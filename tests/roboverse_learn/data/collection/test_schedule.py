"""The order of a collection, under any interleaving of its workers and any number of kills."""

import json
import shutil
import tempfile
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.atomic import write_json
from envs.core.errors import DatasetError
from roboverse_learn.data.collection.schedule import COLLECTION_PATH, Schedule, TooFewSuccessesError
from roboverse_learn.data.dataset.staging import STAGING_DIRECTORY, staged_directory

POOL = 30


@pytest.fixture(autouse=True, scope="module")
def _staged_folders_are_empty():
    with mock.patch("roboverse_learn.data.collection.schedule.load_staged", lambda directory: directory):
        yield


class Writer:
    """Remembers what is committed, as the rows on the disk do, over kills of the process."""

    def __init__(self, root, committed=()):
        self.root, self.committed = Path(root), list(committed)

    @property
    def episode_keys(self):
        return frozenset(json.dumps({"episode": index}) for index in self.committed)

    @property
    def num_episodes(self):
        return len(self.committed)

    @property
    def is_empty(self):
        return not self.committed and not any(staged_directory(self.root, 0).parent.glob("pool_*"))

    def commit(self, *directories):
        for directory in directories:
            self.committed.append(int(directory.name.removeprefix("pool_")))
            shutil.rmtree(directory, ignore_errors=True)


def begun(root, committed):
    """The writer of a collection with empty settings that committed some episodes in an earlier run."""
    write_json(root / COLLECTION_PATH, {"settings": {}, "failed": []})
    return Writer(root, committed)


def end(schedule, root, index, fails):
    """Ends a candidate as a worker does: a staged folder, or a failure."""
    directory = None if index in fails else staged_directory(root, index)
    if directory is not None:
        directory.mkdir(parents=True, exist_ok=True)
    schedule.resolve((index, directory))


collections = st.fixed_dictionaries(
    {
        "order": st.permutations(range(POOL)),
        "fails": st.sets(st.integers(0, POOL - 1), max_size=POOL // 2),
        "target": st.integers(1, POOL // 2),
        "seed": st.integers(0, 2**32 - 1),
    }
)


@given(case=collections, kill_rate=st.sampled_from([0.0, 0.05, 0.2]))
@settings(max_examples=60, deadline=None)
def test_episodes_do_not_depend_on_interleaving_or_kills(case, kill_rate):
    order, fails, target = case["order"], case["fails"], case["target"]
    rng = np.random.default_rng(case["seed"])
    with tempfile.TemporaryDirectory() as folder:
        writer = Writer(folder)
        schedule, flying, tried, ended = Schedule(writer, order, target, {}), [], set(), set()
        while not schedule.finished:
            if rng.random() < kill_rate:  # what flies is lost, what is staged or failed is kept
                schedule, flying = Schedule(writer, order, target, {}), []
            elif rng.random() < 0.5 and (index := schedule.next_index()) is not None:
                assert index not in ended, "an episode that had ended was tried again"
                flying.append(index)
                tried.add(index)
            elif flying:
                index = flying.pop(int(rng.integers(len(flying))))
                ended.add(index)
                end(schedule, writer.root, index, fails)
            assert writer.committed == [i for i in order if i in writer.committed]
        good = [index for index in order if index not in fails][:target]
        assert writer.committed == good
        assert tried == set(order[: order.index(good[-1]) + 1]), "unneeded candidates were tried"
        assert not flying
        assert not list((writer.root / STAGING_DIRECTORY).glob("pool_*"))
        assert schedule.num_failures == len(tried & fails)


@given(case=collections)
@settings(max_examples=30, deadline=None)
def test_no_more_are_in_flight_than_may_be_needed(case):
    """However many ask, those in flight and those done never exceed the target."""
    with tempfile.TemporaryDirectory() as folder:
        writer = Writer(folder)
        schedule = Schedule(writer, case["order"], case["target"], {})
        while not schedule.finished:
            flying = list(iter(schedule.next_index, None))
            assert schedule.num_successes + len(flying) == case["target"]
            for index in reversed(flying):
                end(schedule, writer.root, index, case["fails"])


@given(first=st.integers(1, 8), second=st.integers(1, 14))
@settings(max_examples=25, deadline=None)
def test_asking_for_more_later_is_asking_for_them_at_once(first, second):
    fails = {1, 2, 7}
    with tempfile.TemporaryDirectory() as folder:
        writer = Writer(folder)
        for target in (first, second):
            schedule = Schedule(writer, range(POOL), target, {})
            while not schedule.finished:
                end(schedule, writer.root, schedule.next_index(), fails)
        good = [index for index in range(POOL) if index not in fails]
        assert writer.committed == good[: max(first, second)]


def test_late_success_waits_for_earlier_episodes(tmp_path):
    writer = Writer(tmp_path)
    schedule = Schedule(writer, [5, 3, 9], 2, {})
    assert [schedule.next_index(), schedule.next_index(), schedule.next_index()] == [5, 3, None]
    end(schedule, tmp_path, 3, ())
    assert writer.committed == [] and schedule.num_successes == 1
    assert staged_directory(tmp_path, 3).is_dir()
    end(schedule, tmp_path, 5, {5})
    assert writer.committed == [3]
    assert schedule.next_index() == 9


def test_candidates_that_end_together_are_committed_together_in_their_order(tmp_path):
    writer, commits = Writer(tmp_path), []
    commit_one_by_one = writer.commit
    writer.commit = lambda *directories: (commits.append(len(directories)), commit_one_by_one(*directories))
    schedule = Schedule(writer, range(4), 3, {})
    assert [schedule.next_index() for _ in range(3)] == [0, 1, 2]
    staged = [staged_directory(tmp_path, index) for index in (0, 2)]
    for directory in staged:
        directory.mkdir(parents=True)
    schedule.resolve((2, staged[1]), (1, None), (0, staged[0]))
    assert writer.committed == [0, 2] and commits == [2]
    assert schedule.num_failures == 1 and schedule.next_index() == 3


def test_successes_that_end_beside_the_failure_that_ends_a_collection_are_committed(tmp_path):
    writer = Writer(tmp_path)
    schedule = Schedule(writer, range(3), 3, {}, give_up_after=1)
    assert [schedule.next_index() for _ in range(3)] == [0, 1, 2]
    directory = staged_directory(tmp_path, 0)
    directory.mkdir(parents=True)
    with pytest.raises(TooFewSuccessesError, match="will not give the 3 successes"):
        schedule.resolve((0, directory), (1, None))
    assert writer.committed == [0]


def test_episodes_of_another_candidate_list_count(tmp_path):
    """A dataset that was begun with other candidates needs only what is missing."""
    writer = begun(tmp_path, [100, 101])
    schedule = Schedule(writer, [1, 2, 3], 3, {})
    assert [schedule.next_index(), schedule.next_index()] == [1, None]
    end(schedule, tmp_path, 1, ())
    assert schedule.finished and writer.committed == [100, 101, 1]


def test_a_staged_episode_that_was_committed_before_the_kill_is_removed(tmp_path):
    staged_directory(tmp_path, 4).mkdir(parents=True)
    schedule = Schedule(begun(tmp_path, [4]), [4, 5], 2, {})
    assert not staged_directory(tmp_path, 4).exists()
    assert schedule.num_successes == 1 and schedule.next_index() == 5


def test_a_damaged_staged_episode_is_tried_again(tmp_path):
    staged_directory(tmp_path, 4).mkdir(parents=True)
    with mock.patch(
        "roboverse_learn.data.collection.schedule.load_staged", side_effect=DatasetError("damaged")
    ):
        schedule = Schedule(Writer(tmp_path), [4], 1, {})
    assert not staged_directory(tmp_path, 4).exists()
    assert schedule.next_index() == 4


def test_a_record_without_its_keys_is_named(tmp_path):
    (tmp_path / COLLECTION_PATH).parent.mkdir(parents=True)
    (tmp_path / COLLECTION_PATH).write_text("{}")
    with pytest.raises(DatasetError, match=r"collection.json' is truncated or damaged"):
        Schedule(Writer(tmp_path), [4], 1, {})


def test_failures_are_remembered_over_runs_with_their_settings(tmp_path):
    schedule = Schedule(Writer(tmp_path), [6, 7], 1, {"level": 0, "task": "PickCube"})
    end(schedule, tmp_path, schedule.next_index(), {6})
    record = json.loads((tmp_path / COLLECTION_PATH).read_text())
    assert record == {"settings": {"level": 0, "task": "PickCube"}, "failed": [6]}
    again = Schedule(Writer(tmp_path), [6, 7], 1, {"task": "PickCube", "level": 0})
    assert again.num_failures == 1 and again.next_index() == 7
    end(again, tmp_path, 7, ())
    with pytest.raises(
        DatasetError, match=r"was begun with level=0; now given: level=2. Use the same settings"
    ):
        Schedule(Writer(tmp_path, [7]), [6, 7], 1, {"task": "PickCube", "level": 2})
    assert Schedule(Writer(tmp_path), [6, 7], 1, {"task": "PickCube", "level": 2}).num_failures == 0


def test_a_dataset_of_no_collection_is_not_collected_into(tmp_path):
    with pytest.raises(DatasetError, match=r"episodes that were not collected there\. Choose another folder"):
        Schedule(Writer(tmp_path, [7]), [6, 7], 2, {"level": 0})
    assert not (tmp_path / COLLECTION_PATH).exists()


def test_unrequested_episodes_are_refused(tmp_path):
    schedule = Schedule(Writer(tmp_path), [1, 2], 1, {})
    with pytest.raises(DatasetError, match="yielded pool episode 7, which was not requested"):
        schedule.resolve((7, None))
    schedule.next_index()
    schedule.resolve((1, None))
    with pytest.raises(DatasetError, match="yielded pool episode 1, which was not requested"):
        schedule.resolve((1, None))


def test_run_without_success_ends_and_the_next_one_resumes(tmp_path):
    def run():
        schedule = Schedule(Writer(tmp_path), range(POOL), 2, {}, give_up_after=5)
        with pytest.raises(
            TooFewSuccessesError,
            match=r"^None of the (5|10) episodes .* succeeded\. The same command tries others\.$",
        ):
            while (index := schedule.next_index()) is not None:
                schedule.resolve((index, None))
        return json.loads((tmp_path / COLLECTION_PATH).read_text())["failed"]

    assert run() == list(range(5))
    assert run() == list(range(10))


@pytest.mark.slow
@pytest.mark.parametrize(("target", "tried"), [(400, 102), (100, 278)])
def test_a_run_ends_once_all_the_candidates_will_not_be_enough(tmp_path, target, tried):
    """One in a hundred of 2,000 succeeds, which is sooner too few for 400 than for 100."""
    schedule = Schedule(Writer(tmp_path), range(2000), target, {})
    with pytest.raises(
        TooFewSuccessesError,
        match=rf"^{tried // 100 + 1} of the {tried} episodes that were tried succeeded \(\d\.\d%\)\. "
        rf"All 2000 will not give the {target} successes that are needed\. num_demos=",
    ):
        while (index := schedule.next_index()) is not None:
            end(schedule, tmp_path, index, {number for number in range(2000) if number % 100})


@pytest.mark.parametrize("committed", [[], [7]])
def test_where_fewer_will_do_one_success_is_hope_enough(tmp_path, committed):
    writer = begun(tmp_path, committed)
    schedule = Schedule(writer, range(100, 110), 3, {}, fewer_ok=True, give_up_after=2)
    fails = set(range(101, 110)) | {100} if committed else set(range(101, 110))
    while (index := schedule.next_index()) is not None:
        end(schedule, writer.root, index, fails)
    assert schedule.finished
    assert schedule.num_failures == len(fails)


def test_too_few_successes_is_raised_after_the_last_candidate(tmp_path):
    schedule = Schedule(Writer(tmp_path), range(3), 3, {})
    there_is = rf"num_demos=1 dataset={tmp_path} takes those that there are\.$"
    with pytest.raises(TooFewSuccessesError, match=rf"The 3 .* gave 1 successes; 3 are needed\. {there_is}"):
        while (index := schedule.next_index()) is not None:
            end(schedule, tmp_path, index, {1, 2})


def test_too_few_successes_wait_for_those_in_flight(tmp_path):
    """The error is raised when the last candidate has failed, not while one may still succeed."""
    schedule = Schedule(Writer(tmp_path), [1, 2], 2, {})
    assert [schedule.next_index(), schedule.next_index()] == [1, 2]
    schedule.resolve((1, None))
    assert schedule.next_index() is None
    schedule.resolve((2, None))
    with pytest.raises(DatasetError, match=r"The 2 candidate episodes gave 0 successes; 2 are needed"):
        schedule.next_index()
