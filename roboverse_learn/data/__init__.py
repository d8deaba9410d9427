"""LeRobotDataset v3 in and out: crash-safe writing, parallel collection, resident reading.

>>> with DatasetWriter(root, fps=20, features=make_features(...)) as writer:    # doctest: +SKIP
...     writer.add_episode(episode)
>>> dataset = ResidentDataset(root)                                             # doctest: +SKIP
>>> batch = dataset.sample([0, 7], {"action": range(20)})                       # doctest: +SKIP
"""

from roboverse_learn.data.collection import CollectionProgress, CollectionSummary, collect
from roboverse_learn.data.collection_pool import CollectionConfig
from roboverse_learn.data.info import DatasetInfo
from roboverse_learn.data.merge import consolidate, merge
from roboverse_learn.data.raw import dataset_hash, read_raw
from roboverse_learn.data.reader import ResidentDataset
from roboverse_learn.data.recovery import recover
from roboverse_learn.data.sampler import EpisodeAwareSampler
from roboverse_learn.data.schema import EpisodeData, make_features
from roboverse_learn.data.sources import EpisodeSource
from roboverse_learn.data.video import EncoderConfig
from roboverse_learn.data.writer import DatasetWriter

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
