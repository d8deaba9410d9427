"""Statistics against numpy, and what merging may and may not do to them."""

import copy
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from envs.core.errors import DatasetError
from roboverse_learn.data import DatasetInfo, DatasetWriter
from roboverse_learn.data.dataset.stats import (
    QUANTILES,
    STATISTICS,
    column_stats,
    combine,
    from_json,
    image_stats,
    merge_stats,
    to_json,
)
from tests.roboverse_learn.data.synthetic_episodes import FEATURES, FPS, make_episode

STATE = "observation.state"


def one(values):
    return column_stats({"x": np.asarray(values, float)})


def test_a_column_by_hand():
    stats = one([[1.0, 10.0], [3.0, 10.0], [5.0, 40.0], [7.0, 40.0]])["x"]
    assert set(stats) == set(STATISTICS)
    assert stats["min"].tolist() == [1.0, 10.0] and stats["max"].tolist() == [7.0, 40.0]
    assert stats["mean"].tolist() == [4.0, 25.0]
    np.testing.assert_allclose(stats["std"], [np.sqrt(5.0), 15.0])  # of the population: divided by 4
    assert stats["count"].tolist() == [4] and stats["count"].dtype == np.int64
    # Linear between order statistics: position 0.1 * (4 - 1) = 0.3 between 1 and 3.
    np.testing.assert_allclose(stats["q10"], [1.6, 10.0])
    np.testing.assert_allclose(stats["q50"], [4.0, 25.0])
    np.testing.assert_allclose(stats["q99"], [6.94, 40.0])


def test_a_column_of_scalars_or_bools_has_shape_one():
    assert {value.shape for value in one(np.arange(5))["x"].values()} == {(1,)}
    stats = column_stats({"x": np.array([False, False, True, True])})["x"]
    assert (stats["mean"], stats["std"], stats["min"], stats["max"]) == (0.5, 0.5, 0.0, 1.0)


def test_columns_do_not_depend_on_those_beside_them():
    rng = np.random.default_rng(0)
    values = {"x": rng.normal(size=(90, 9)).astype(np.float32), "y": rng.integers(0, 5, 90)}
    together = column_stats(values)
    assert list(together) == ["x", "y"]
    for key in values:
        alone = column_stats({key: values[key]})[key]
        assert {name: value.tolist() for name, value in together[key].items()} == {
            name: value.tolist() for name, value in alone.items()
        }


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40))
@settings(deadline=None)
def test_quantiles_are_numpys_to_the_last_bit(values):
    stats = one(values)["x"]
    for name, quantile in QUANTILES.items():
        assert stats[name][0] == np.quantile(values, quantile)


columns = st.lists(st.lists(st.floats(-1e3, 1e3, width=32), min_size=1, max_size=12), min_size=1, max_size=6)


@given(parts=columns)
@settings(deadline=None)
def test_merged_moments_are_those_of_all_frames(parts):
    whole, merged = one(np.concatenate(parts))["x"], combine(one(part) for part in parts)["x"]
    for name in ("min", "max", "count"):
        np.testing.assert_array_equal(merged[name], whole[name])
    for name in ("mean", "std"):
        np.testing.assert_allclose(merged[name], whole[name], rtol=1e-7, atol=1e-6)


@given(parts=columns)
@settings(deadline=None)
def test_merged_quantiles_are_the_mean_of_the_parts_by_their_frames(parts):
    merged = combine(one(part) for part in parts)["x"]
    lengths = [len(part) for part in parts]
    for name, quantile in QUANTILES.items():
        expected = np.average([np.quantile(part, quantile) for part in parts], weights=lengths)
        np.testing.assert_allclose(merged[name], expected, rtol=1e-7, atol=1e-6)
        assert merged["min"] - 1e-6 <= merged[name] <= merged["max"] + 1e-6


@given(parts=columns)
@settings(deadline=None)
def test_the_order_of_merging_does_not_matter(parts):
    forwards, backwards = (combine(one(part) for part in order)["x"] for order in (parts, parts[::-1]))
    for name in STATISTICS:
        np.testing.assert_allclose(forwards[name], backwards[name], rtol=1e-7, atol=1e-6)


def test_the_variance_of_far_apart_parts_is_between_them():
    """Two constants: no part varies, together they do (the term that a mean of variances lacks)."""
    merged = merge_stats(one([0.0] * 3), one([8.0]))["x"]
    assert merged["mean"] == 2.0
    np.testing.assert_allclose(merged["std"] ** 2, (3 * 2.0**2 + 6.0**2) / 4)


def test_a_large_offset_keeps_its_small_variance():
    """E[x²] - E[x]² would lose all digits here."""
    rng = np.random.default_rng(0)
    values = 1e6 + rng.normal(scale=1e-3, size=200)
    merged = combine(one(part) for part in np.split(values, 10))["x"]
    np.testing.assert_allclose(merged["std"], values.std(), rtol=1e-4)


def test_merging_changes_neither_argument():
    first, second = one([1.0, 2.0]), one([5.0])
    before = copy.deepcopy((first, second))
    merge_stats(first, second)
    for given_stats, kept in zip((first, second), before, strict=True):
        for name in STATISTICS:
            np.testing.assert_array_equal(given_stats["x"][name], kept["x"][name])
    assert merge_stats(None, first) is first
    assert combine([]) is None


def test_json_keeps_every_digit():
    stats = one(np.random.default_rng(1).normal(size=7))
    back = from_json(json.loads(json.dumps(to_json(stats))))
    for name in STATISTICS:
        np.testing.assert_array_equal(back["x"][name], stats["x"][name])


@pytest.mark.parametrize(("size", "stride"), [((32, 48), (1, 1)), ((128, 192), (2, 3)), ((64, 256), (1, 4))])
def test_images_are_sampled_on_a_grid(size, stride):
    rng = np.random.default_rng(2)
    images = rng.integers(0, 256, (9, *size, 3), dtype=np.uint8)
    stats = image_stats(images)
    seen = images[::4, :: stride[0], :: stride[1]].reshape(-1, 3) / 255
    assert stats["count"].tolist() == [3]  # frames 0, 4 and 8
    for name, expected in (("mean", seen.mean(0)), ("std", seen.std(0)), ("min", seen.min(0))):
        np.testing.assert_allclose(stats[name].ravel(), expected, rtol=1e-9)


def test_channels_are_kept_apart():
    stats = image_stats(np.broadcast_to(np.array([0, 51, 255], np.uint8), (1, 8, 8, 3)))
    for name in ("min", "max", "mean", *QUANTILES):
        np.testing.assert_allclose(stats[name].ravel(), [0.0, 0.2, 1.0], atol=1e-12)
    np.testing.assert_allclose(stats["std"], 0.0, atol=1e-9)


def test_quantiles_are_averages_until_the_dataset_is_closed(tmp_path):
    episodes = [make_episode(index) for index in range(3)]
    every = np.concatenate([episode.states for episode in episodes])
    with DatasetWriter(tmp_path / "d", fps=FPS, features=FEATURES) as writer:
        for episode in episodes:
            writer.add_episode(episode)
        stats = DatasetInfo.open(tmp_path / "d").stats[STATE]
        parts = [np.quantile(episode.states.astype(float), 0.9, axis=0) for episode in episodes]
        expected = np.average(parts, axis=0, weights=[episode.length for episode in episodes])
        np.testing.assert_allclose(stats["q90"], expected)
        np.testing.assert_allclose(stats["mean"], every.mean(axis=0, dtype=float))
    stats = DatasetInfo.open(tmp_path / "d").stats[STATE]
    np.testing.assert_allclose(stats["q90"], np.quantile(every.astype(float), 0.9, axis=0))
    assert stats["count"] == [len(every)]
    with pytest.raises(DatasetError, match=r"The writer of '.*' is closed. Open a new DatasetWriter"):
        writer.add_episode(episodes[0])
