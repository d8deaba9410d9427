"""LeRobotDataset v3 in and out: crash-safe writing, parallel collection, resident reading.

>>> with DatasetWriter(root, fps=20, features=make_features(...)) as writer:    # doctest: +SKIP
...     writer.add_episode(episode)
>>> dataset = ResidentDataset(root)                                             # doctest: +SKIP
>>> batch = dataset.sample([0, 7], {"action": range(20)})                       # doctest: +SKIP
"""

from roboverse_learn.data.collection.collect import CollectionProgress, CollectionSummary, collect
from roboverse_learn.data.collection.pool import CollectionConfig
from roboverse_learn.data.dataset.info import DatasetInfo
from roboverse_learn.data.dataset.merge import consolidate, merge
from roboverse_learn.data.dataset.raw import dataset_hash, read_raw
from roboverse_learn.data.dataset.reader import ResidentDataset
from roboverse_learn.data.dataset.recovery import recover
from roboverse_learn.data.dataset.sampler import EpisodeAwareSampler
from roboverse_learn.data.dataset.schema import EpisodeData, make_features
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.dataset.writer import DatasetWriter
from roboverse_learn.data.sources.base import EpisodeSource

__all__ = [
    "CollectionConfig",
    "CollectionProgress",
    "CollectionSummary",
    "DatasetInfo",
    "DatasetWriter",
    "EncoderConfig",
    "EpisodeAwareSampler",
    "EpisodeData",
    "EpisodeSource",
    "ResidentDataset",
    "collect",
    "consolidate",
    "dataset_hash",
    "make_features",
    "merge",
    "read_raw",
    "recover",
]
