"""Several datasets as one."""

import re
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from envs.core.errors import ConfigError, DatasetError
from policies.learned_tasks import LearnedTask
from roboverse_learn.data import DatasetInfo, DatasetWriter, ResidentDataset
from roboverse_learn.data.dataset import decoders
from roboverse_learn.data.dataset.mixture import Mixture
from roboverse_learn.data.dataset.sampler import (
    EpisodeAwareSampler,
    MixtureSampler,
    make_sampler,
    shares_of_a_batch,
)
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, make_episode
from tests.roboverse_learn.data.two_tasks import TEXTS, write

KEYS = ["observation.images.front", "observation.state", "action", "task_index"]


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("two")
    return {"Right": write(root / "right", "Right", 6), "Left": write(root / "left", "Left", 2)}


@pytest.fixture(scope="module")
def mixture(folders):
    return Mixture.open(folders, "cpu")


def test_frames_are_those_of_each_dataset_padded_with_zeros(folders, mixture):
    right, left = (ResidentDataset(folder) for folder in folders.values())
    assert len(mixture) == len(right) + len(left) == 40
    indices = np.array([31, 0, 7, 39, 29, 30])
    found = mixture.sample(indices, {"action": range(3)}, keys=KEYS)
    for row, index in enumerate(indices):
        part, own = (right, index) if index < 30 else (left, index - 30)
        expected = part.sample([own], {"action": range(3)}, keys=KEYS)
        width = expected["action"].shape[-1]
        assert found["action"][row, :, :width].equal(expected["action"][0])
        assert not found["action"][row, :, width:].any()
        for key in ("observation.images.front", "observation.state", "action_is_pad"):
            assert found[key][row].equal(expected[key][0]), key
        first_text = 0 if index < 30 else 2
        assert found["task_index"][row] == expected["task_index"][0] + first_text


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux shares images")
def test_the_same_processes_decode_all_datasets(folders, mixture, monkeypatch):
    made = []

    def make(*args):
        made.append(ProcessPoolExecutor(*args))
        return made[-1]

    monkeypatch.setattr(decoders, "FRAMES_A_PROCESS", 10)
    monkeypatch.setattr(decoders, "ProcessPoolExecutor", make)
    monkeypatch.setattr("roboverse_learn.data.dataset.mixture.num_cores", lambda: 3)
    found = Mixture.open(folders, "cpu").sample(np.arange(40), keys=KEYS)
    assert len(made) == 1
    with pytest.raises(RuntimeError, match="shutdown"):
        made[0].submit(len, "")
    expected = mixture.sample(np.arange(40), keys=KEYS)
    for key in KEYS:
        assert found[key].equal(expected[key]), key


def test_processes_are_as_many_as_the_videos_are_worth_not_the_images(folders, monkeypatch):
    counted, open_info = [], DatasetInfo.open

    def with_images_in_tables(root):
        info = open_info(root)
        depth = {"dtype": "image", "shape": (32, 32, 3), "names": ["height", "width", "channels"]}
        return replace(info, features=info.features | {"observation.images.depth": depth})

    class Counted(decoders.Decoders):
        def __init__(self, num_images, at_most):
            counted.append(num_images)
            raise StopIteration

    monkeypatch.setattr(DatasetInfo, "open", with_images_in_tables)
    monkeypatch.setattr("roboverse_learn.data.dataset.mixture.Decoders", Counted)
    with pytest.raises(StopIteration):
        Mixture.open(folders, "cpu")
    assert counted == [40]


def test_reading_datasets_says_how_far_it_is(folders, monkeypatch, caplog):
    monkeypatch.setattr("roboverse_learn.data.dataset.mixture.SECONDS_A_MESSAGE", 0.0)
    with caplog.at_level("INFO", "roboverse_learn.data.dataset.mixture"):
        Mixture.open(folders, "cpu")
    assert caplog.messages == ["1 of 2 datasets are decoded.", "2 of 2 datasets are decoded."]


def test_instructions_are_counted_over_all_datasets_and_each_is_of_its_task(mixture):
    instructions = mixture.instructions
    states = ("q0", "q1", "q2", "q3")
    assert instructions.texts == (*TEXTS["Right"], *TEXTS["Left"]) == mixture.info.tasks
    assert instructions.tasks == (
        LearnedTask(
            name="Right", state_size=4, action_size=3, state_names=states, action_names=("a0", "a1", "a2")
        ),
        LearnedTask(name="Left", state_size=4, action_size=2, state_names=states, action_names=("a0", "a1")),
    )
    assert instructions.task_of == (0, 0, 1)


def test_features_are_the_largest(mixture):
    assert mixture.info.shapes["action"] == (3,)
    assert mixture.info.features["action"]["names"] == ["a0", "a1", "a2"]
    assert mixture.info.num_episodes == 8 and mixture.info.num_frames == 40
    assert mixture.info.episode_starts.tolist() == [0, 5, 10, 15, 20, 25, 30, 35]
    assert [group.tolist() for group in mixture.groups] == [[0, 1, 2, 3, 4, 5], [6, 7]]


def test_statistics_weigh_each_task_alike_and_padding_not_at_all(folders, mixture):
    right, left = (DatasetInfo.open(folder).read_columns(["action"])["action"] for folder in folders.values())
    # Three copies of the smaller dataset have as many frames as the larger one.
    both = np.concatenate([right[:, :2], np.tile(left, (3, 1))])
    found = mixture.info.stats["action"]
    np.testing.assert_allclose(found["mean"], [*both.mean(0), right[:, 2].mean()], atol=1e-6)
    np.testing.assert_allclose(found["std"], [*both.std(0), right[:, 2].std()], atol=1e-6)
    np.testing.assert_allclose(found["min"], [*both.min(0), right[:, 2].min()])
    np.testing.assert_allclose(found["max"], [*both.max(0), right[:, 2].max()])
    for name, level in (("q01", 0.01), ("q10", 0.1), ("q99", 0.99)):
        expected = [np.quantile(values, level, 0, method="inverted_cdf") for values in (both, right[:, 2:])]
        np.testing.assert_allclose(found[name], np.concatenate(expected))
    assert mixture.info.stats["observation.images.front"]["mean"].shape == (3, 1, 1)


def test_one_dataset_keeps_its_quantiles_by_which_some_policies_normalize(folders):
    info = DatasetInfo.open(folders["Right"])
    found = Mixture.open({"Right": folders["Right"]}, "cpu").info.stats
    assert found.keys() == info.stats.keys()
    for key, own in info.stats.items():
        assert found[key].keys() == own.keys()
        for name in ("q01", "q99", "mean", "max"):
            np.testing.assert_allclose(found[key][name], own[name], err_msg=f"{key} {name}")


def test_a_dataset_of_several_tasks_is_split_by_the_tasks_that_its_episodes_name(tmp_path):
    root = tmp_path / "both"
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        for index in range(3):
            episode = make_episode(index, task=f"wording {index}")
            episode.metadata["task"] = "StackCube" if index == 1 else "PickCube"
            writer.add_episode(episode)
    mixture = Mixture.open({"Unused": root}, "cpu")
    assert [task.name for task in mixture.instructions.tasks] == ["PickCube", "StackCube"]
    assert mixture.instructions.task_of == (0, 1, 0)
    assert [group.tolist() for group in mixture.groups] == [[0, 2], [1]]
    actions = [make_episode(index).actions for index in range(3)]
    means = np.mean([np.concatenate([actions[0], actions[2]]).mean(0), actions[1].mean(0)], 0)
    np.testing.assert_allclose(mixture.info.stats["action"]["mean"], means, atol=1e-6)


def test_episodes_that_name_no_task_are_of_the_one_that_is_given(tmp_path):
    root = tmp_path / "plain"
    with DatasetWriter(root, fps=20, features=FEATURES) as writer:
        episode = make_episode(0)
        del episode.metadata["task"]
        writer.add_episode(episode)
    assert [task.name for task in Mixture.open({"Given": root}, "cpu").instructions.tasks] == ["Given"]


def test_other_cameras_are_an_error(folders, tmp_path):
    from roboverse_learn.data import make_features
    from tests.roboverse_learn.data.two_tasks import make_episode as two_tasks_episode

    root = tmp_path / "small"
    episode = two_tasks_episode("Left", 0, "push left", 4)
    episode.images["front"] = episode.images["front"][:, :16, :16]
    features = make_features([f"q{i}" for i in range(4)], ["a0", "a1"], {"front": (16, 16)})
    with DatasetWriter(root, fps=20, features=features) as writer:
        writer.add_episode(episode)
    with pytest.raises(DatasetError, match=r"cannot be learned together.*same cameras and image_size"):
        Mixture.open({"Right": folders["Right"], "Left": root}, "cpu")


# --- sampling -----------------------------------------------------------------------------------


def test_each_task_is_sampled_equally_often(mixture):
    sampler = make_sampler(mixture, batch_size=7, seed=0)
    batches = [sampler.next_batch() for _ in range(20)]
    of_left = [int((batch >= 30).sum()) for batch in batches]
    assert {len(batch) for batch in batches} == {7}
    assert set(of_left) == {3, 4} and sum(of_left) == 70
    assert all((np.diff(batch >= 30) >= 0).all() for batch in batches)  # one task after the other
    left = np.concatenate(batches)
    counts = np.bincount(left[left >= 30] - 30)
    assert counts.max() - counts.min() == 0  # 70 samples of 10 frames: without replacement


@pytest.mark.parametrize(
    ("mixing", "of_left"),
    [(0.0, [3, 4, 3, 4]), (0.5, [3, 2, 3, 2]), (1.0, [2, 1, 2, 2])],  # 3.5, 2.56 and 1.75 of 7
)
def test_a_tasks_share_of_a_batch_follows_its_frames(mixture, mixing, of_left):
    sampler = make_sampler(mixture, batch_size=7, seed=0, mixing=mixing)
    batches = [sampler.next_batch() for _ in range(400)]
    found = [int((batch >= 30).sum()) for batch in batches]
    assert found[:4] == of_left and {len(batch) for batch in batches} == {7}
    share = 10**mixing / (10**mixing + 30**mixing)
    assert abs(sum(found) - 400 * 7 * share) <= 1.0


def test_tasks_with_less_than_a_frame_of_a_batch_are_refused(mixture):
    with pytest.raises(
        ConfigError,
        match=r"a share of 0\.75\. Give train\.batch_size=4 or more, or train\.mixing of at most 0\.63\.$",
    ):
        make_sampler(mixture, batch_size=3, seed=0, mixing=1.0)
    for fitting in ({"batch_size": 4, "mixing": 1.0}, {"batch_size": 3, "mixing": 0.63}, {"batch_size": 3}):
        make_sampler(mixture, seed=0, **fitting)
    with pytest.raises(ConfigError, match=r"a share of 0\.99"):
        make_sampler(mixture, batch_size=3, seed=0, mixing=0.64)


@pytest.mark.parametrize(
    ("frames", "batch_size", "mixing", "world_size", "advice"),
    [
        ([1, 1, 1], 2, 0.5, 1, "train.batch_size=3 or more"),
        ([1, 1, 1], 3, 0.0, 2, "train.batch_size=4 or more"),
        ([30, 10], 6, 1.0, 4, "train.batch_size=8 or more"),
        ([90, 10], 8, 1.0, 4, "train.batch_size=12 or more, or train.mixing of at most 0.88"),
        ([1000, 1], 2, 1.0, 1, "train.batch_size=1001 or more, or train.mixing of at most 0"),
    ],
)
def test_who_gives_what_is_said_is_not_refused_again(frames, batch_size, mixing, world_size, advice):
    with pytest.raises(ConfigError, match=rf"Give {re.escape(advice)}\.$"):
        shares_of_a_batch(frames, batch_size, mixing, world_size)
    least = int(re.findall(r"batch_size=(\d+)", advice)[0])
    assert shares_of_a_batch(frames, least, mixing, world_size).min() >= 1.0
    if least - world_size > batch_size:
        with pytest.raises(ConfigError):
            shares_of_a_batch(frames, least - world_size, mixing, world_size)
    for largest in re.findall(r"at most (.*)", advice):
        assert shares_of_a_batch(frames, batch_size, float(largest), world_size).min() >= 1.0


@pytest.mark.parametrize("mixing", [0.0, 1.0])
def test_tasks_without_a_frame_are_refused_with_what_to_do(mixing):
    with pytest.raises(ConfigError, match=r"^1 of 2 tasks have no frame in the dataset\. Give one with"):
        shares_of_a_batch([10, 0], 4, mixing)


@pytest.mark.parametrize(
    ("mixing", "advice"),
    [
        (0.0, "Give train.batch_size=3 or more."),
        (
            0.5,
            "Give train.batch_size of at least 3: with train.mixing=0.5 a task that turns out to have fewer "
            "frames than others needs more.",
        ),
    ],
)
def test_a_batch_for_lengths_that_are_not_known_is_the_least_only_where_tasks_weigh_alike(mixing, advice):
    with pytest.raises(ConfigError) as refused:
        shares_of_a_batch([1, 1, 1], 2, mixing, guessed=True)
    assert str(refused.value).endswith(advice)


@pytest.mark.parametrize("mixing", [0.0, 0.5])
def test_a_restored_sampler_continues(mixture, mixing):
    whole, first = (make_sampler(mixture, batch_size=5, seed=3, mixing=mixing) for _ in range(2))
    expected = [whole.next_batch() for _ in range(8)]
    for _ in range(4):
        first.next_batch()
    second = make_sampler(mixture, batch_size=5, seed=3, mixing=mixing)
    second.load_state_dict(first.state_dict())
    for batch in expected[4:]:
        np.testing.assert_array_equal(second.next_batch(), batch)
    assert not np.array_equal(expected[0], make_sampler(mixture, batch_size=5, seed=4).next_batch())


@pytest.mark.parametrize("batches", [1, 4, 13])
def test_a_state_from_before_shares_could_differ_goes_on(mixture, batches):
    whole = make_sampler(mixture, batch_size=7, seed=3)
    for _ in range(batches):
        whole.next_batch()
    groups = [{"epoch": epoch, "position": position} for epoch, position in _positions(batches)]
    old = make_sampler(mixture, batch_size=7, seed=3)
    old.load_state_dict({"turn": batches % 2, "groups": groups})  # as BalancedSampler saved it
    for _ in range(20):
        np.testing.assert_array_equal(old.next_batch(), whole.next_batch())


def _positions(batches: int) -> list[tuple[int, int]]:
    """Returns epochs and positions after batches of 3 and 4 frames in turn, of 30 and of 10 frames."""
    sampled = [batches * 3 + (batches + 1) // 2, batches * 3 + batches // 2]
    return [divmod(number, frames) for number, frames in zip(sampled, (30, 10), strict=True)]


def test_processes_share_a_batch(mixture):
    whole = make_sampler(mixture, batch_size=8, seed=0).next_batch()
    shares = [
        make_sampler(mixture, batch_size=8, seed=0, rank=rank, world_size=2).next_batch() for rank in (0, 1)
    ]
    np.testing.assert_array_equal(np.sort(np.concatenate(shares)), np.sort(whole))
    assert all((share >= 30).sum() == 2 for share in shares)


def test_a_batch_has_a_frame_of_each_task(mixture):
    with pytest.raises(ConfigError, match=r"batch_size=1 must .* at least one frame of each of 2 tasks"):
        MixtureSampler(mixture.info, mixture.groups, batch_size=1, seed=0)


def test_a_dataset_without_groups_is_sampled_as_before(folders):
    dataset = ResidentDataset(folders["Left"])
    sampler = make_sampler(dataset, batch_size=4, seed=1)
    assert type(sampler) is EpisodeAwareSampler
    plain = EpisodeAwareSampler(dataset.info, batch_size=4, seed=1)
    np.testing.assert_array_equal(sampler.next_batch(), plain.next_batch())
