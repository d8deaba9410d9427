"""Statistics of a dataset, in LeRobot's form: min, max, mean, std, count and five quantiles.

Mean and variance of episodes combine by the parallel algorithm (Chan, Golub, LeVeque 1983), so the
numbers of numeric columns are exact however the episodes arrive. Quantiles do not combine; between
commits they are the frame-weighted mean of the episodes' quantiles, as LeRobot keeps them, and closing
a dataset replaces them by the exact ones.
"""

from collections.abc import Iterable, Mapping

import numpy as np

QUANTILES: dict[str, float] = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
STATISTICS = ("min", "max", "mean", "std", "count", *QUANTILES)

FeatureStats = dict[str, np.ndarray]
Stats = dict[str, FeatureStats]

# Images are sampled: every 4th frame, and about 64 rows and columns of it. `count` says how many frames
# were looked at, so an episode's weight stays proportional to its length.
IMAGE_FRAME_STRIDE = 4
IMAGE_GRID = 64


def column_stats(columns: Mapping[str, np.ndarray]) -> Stats:
    """Returns the statistics of numeric columns by their keys.

    Args:
        columns: Finite, each (T,) or (T, D).

    Returns:
        Of each, arrays of shape (D,), or (1,) for a column of scalars; float64, ``count`` int64 (1,).
    """
    if not columns:
        return {}
    parts = [np.asarray(values, dtype=np.float64).reshape(len(values), -1) for values in columns.values()]
    rows = np.sort(np.concatenate(parts, axis=1), axis=0)  # once, for all quantiles
    quantiles = {name: _quantile(rows, quantile) for name, quantile in QUANTILES.items()}
    stats, start = {}, 0
    for key, part in zip(columns, parts, strict=True):
        own = slice(start, start := start + part.shape[1])
        stats[key] = {
            "min": rows[0, own].copy(),
            "max": rows[-1, own].copy(),
            "mean": part.mean(axis=0),
            "std": part.std(axis=0),
            "count": np.array([len(part)], dtype=np.int64),
            **{name: value[own].copy() for name, value in quantiles.items()},
        }
    return stats


def _quantile(rows: np.ndarray, quantile: float) -> np.ndarray:
    """Returns numpy's default quantile, method "linear", of columns that are sorted (T, D)."""
    place = (len(rows) - 1) * quantile
    before = int(place)
    low, high = rows[before], rows[min(before + 1, len(rows) - 1)]
    share = place - before
    # From the nearer of both, as numpy does: the same to the last bit.
    return high - (high - low) * (1 - share) if share >= 0.5 else low + (high - low) * share


def image_stats(images: np.ndarray) -> FeatureStats:
    """Returns per-channel statistics of an episode's images, scaled to 0..1, from a sample of pixels.

    Args:
        images: uint8 (T, H, W, 3).

    Returns:
        Arrays of shape (3, 1, 1); ``count`` is the number of frames in the sample.
    """
    rows, columns = (max(size // IMAGE_GRID, 1) for size in images.shape[1:3])
    sample = images[::IMAGE_FRAME_STRIDE, ::rows, ::columns]
    histograms = np.stack([np.bincount(sample[..., channel].ravel(), minlength=256) for channel in range(3)])
    levels = np.arange(256) / 255.0
    total = histograms.sum(axis=1)
    mean = histograms @ levels / total
    variance = histograms @ levels**2 / total - mean**2
    cumulative = histograms.cumsum(axis=1)
    stats = {
        "min": levels[(histograms > 0).argmax(axis=1)],
        "max": levels[255 - (histograms[:, ::-1] > 0).argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(variance, 0.0)),
    }
    for name, quantile in QUANTILES.items():
        stats[name] = levels[(cumulative >= quantile * total[:, None]).argmax(axis=1)]
    shaped = {name: value.reshape(3, 1, 1) for name, value in stats.items()}
    return shaped | {"count": np.array([len(sample)], dtype=np.int64)}


def merge_stats(first: Stats | None, second: Stats) -> Stats:
    """Combines the statistics of two disjoint sets of frames; neither argument is changed."""
    if not first:
        return second
    return {key: _merge_feature(first[key], second[key]) for key in first}


def _merge_feature(first: FeatureStats, second: FeatureStats) -> FeatureStats:
    """Combines one feature's statistics: Chan et al. 1983, eq. 2.1, with population variances."""
    count = first["count"] + second["count"]
    weight = float(second["count"][0] / count[0])
    delta = second["mean"] - first["mean"]
    variance = (1 - weight) * first["std"] ** 2 + weight * second["std"] ** 2
    variance = variance + weight * (1 - weight) * delta**2
    merged = {
        "min": np.minimum(first["min"], second["min"]),
        "max": np.maximum(first["max"], second["max"]),
        "mean": first["mean"] + weight * delta,
        "std": np.sqrt(variance),
        "count": count,
    }
    for name in QUANTILES:
        merged[name] = first[name] + weight * (second[name] - first[name])
    return merged


def combine(stats: Iterable[Stats]) -> Stats | None:
    """Combines the statistics of many episodes, or returns None for none."""
    total: Stats | None = None
    for one in stats:
        total = merge_stats(total, one)
    return total


def to_json(stats: Stats) -> dict[str, dict[str, list]]:
    """Returns the form of ``meta/stats.json``."""
    return {key: {name: array.tolist() for name, array in one.items()} for key, one in stats.items()}


def from_json(value: Mapping[str, Mapping[str, list]]) -> Stats:
    """Reads the form of ``meta/stats.json``."""
    return {key: {name: np.atleast_1d(array) for name, array in one.items()} for key, one in value.items()}
