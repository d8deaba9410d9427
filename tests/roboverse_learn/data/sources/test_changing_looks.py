"""Looks that change within an episode, and nothing else does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from envs.core.errors import ConfigError
from envs.randomization import load_split
from roboverse_learn.collect import collect_dataset, dataset_folder
from roboverse_learn.config.compose import compose
from roboverse_learn.data import DatasetInfo, ResidentDataset, read_raw
from roboverse_learn.data.sources.changing_looks import NUM_LOOKS, ChangingLooks

SCENE = ["task=PickCube", "level=3", "image_size=16"]
FRONT = "observation.images.front"


def collected(root, *words, num_envs=2, num_workers=1):
    config = compose("collect", [*SCENE, "num_demos=2", f"dataset={root}", *words])
    sized = replace(config.collect, num_envs=num_envs, num_workers=num_workers)
    return collect_dataset(replace(config, collect=sized))


def frames_of(root, episode):
    info = DatasetInfo.open(root)
    rows = list(range(info.episode_starts[episode], info.episode_ends[episode]))
    return ResidentDataset(info.root).sample(rows, {FRONT: [0]})[FRONT].numpy().astype(np.float32).squeeze(1)


def changes_of(frames):
    """Mean change of the pixels from each frame to the next."""
    return np.abs(np.diff(frames, axis=0)).mean(axis=(1, 2, 3))


@pytest.fixture(scope="module")
def datasets(tmp_path_factory):
    root = tmp_path_factory.mktemp("looks")
    for name, words in (("kept", []), ("each", ["steps_per_look=1"]), ("four", ["steps_per_look=4"])):
        collected(root / name, *words)
    return root


@pytest.mark.slow
def test_states_actions_and_words_are_those_of_episodes_that_keep_their_look(datasets):
    kept, each = (DatasetInfo.open(datasets / name) for name in ("kept", "each"))
    columns = ["observation.state", "action", "task_index"]
    expected = kept.read_columns(columns)
    for key, values in each.read_columns(columns).items():
        np.testing.assert_array_equal(values, expected[key])
    for episode in range(2):
        expected, facts = read_raw(each.root, episode)
        found, _ = read_raw(kept.root, episode)
        assert facts["steps_per_look"] == 1
        assert all(np.array_equal(found[key], values) for key, values in expected.items())


@pytest.mark.slow
def test_an_episode_begins_with_its_own_look_which_changes_after_so_many_steps(datasets):
    for episode in range(2):
        kept, each, four = (frames_of(datasets / name, episode) for name in ("kept", "each", "four"))
        moved = changes_of(kept).max()  # by the arm alone
        assert np.abs(each[0] - kept[0]).mean() < moved and np.abs(four[:4] - kept[:4]).mean() < moved
        assert np.median(changes_of(each)) > 3 * moved
        at_changes = np.arange(1, len(four)) % 4 == 0
        assert np.median(changes_of(four)[at_changes]) > 3 * np.median(changes_of(four)[~at_changes])


@pytest.mark.slow
@pytest.mark.usefixtures("forked_workers")
def test_looks_do_not_depend_on_the_number_of_environments_and_processes(tmp_path):
    one = collected(tmp_path / "one", "num_demos=5", "steps_per_look=3", num_envs=1)
    two = collected(tmp_path / "two", "num_demos=5", "steps_per_look=3", num_envs=3, num_workers=2)
    assert one.dataset_hash == two.dataset_hash


@pytest.mark.slow
def test_rendering_again_gives_the_looks_that_collecting_gives(datasets, tmp_path):
    collected(tmp_path / "again", "source=rerender", f"from={datasets / 'kept'}", "steps_per_look=4")
    for episode in range(2):
        direct, again = frames_of(datasets / "four", episode), frames_of(tmp_path / "again", episode)
        np.testing.assert_array_equal(again, direct)


def test_looks_are_of_the_first_episodes_of_the_environments_split_alone():
    split, seen = load_split("train").episodes, []
    env = SimpleNamespace(
        split_indices=split,
        protocol_seed=0,
        randomizer=SimpleNamespace(appearance=lambda index: index),
        handler=SimpleNamespace(change_look=lambda look, env_id: seen.append((look, env_id))),
    )
    looks = ChangingLooks(env, 2)
    for length in range(9):
        looks(SimpleNamespace(episode=7, env_id=3, length=length))
    assert [env_id for _, env_id in seen] == [3] * 4
    drawn = [look for look, _ in seen]
    assert len(set(drawn)) == 4 and set(drawn) <= set(split[:NUM_LOOKS].tolist())


def test_the_folder_of_a_dataset_names_how_long_a_look_stays(tmp_path):
    words = [*SCENE, f"datasets_dir={tmp_path}"]
    plain, changing = (
        dataset_folder(compose("collect", [*words, *more])) for more in ([], ["steps_per_look=4"])
    )
    assert changing.name == f"{plain.name}-4steps_per_look"


def test_sources_that_keep_their_looks_refuse_the_key():
    said = (
        r"steps_per_look=1 was given, and source=retarget keeps the looks .*"
        r"source=rerender from=<its dataset> steps_per_look=1"
    )
    with pytest.raises(ConfigError, match=said):
        compose("collect", [*SCENE, "source=retarget", "from=datasets/x", "steps_per_look=1"])
