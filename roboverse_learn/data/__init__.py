"""LeRobotDataset v3 in and out: crash-safe writing, parallel collection, resident reading.

Names are imported when they are used, for the command line reads this package's registry of sources.

>>> with DatasetWriter(root, fps=20, features=make_features(...)) as writer:    # doctest: +SKIP
...     writer.add_episode(episode)
>>> dataset = ResidentDataset(root)                                             # doctest: +SKIP
>>> batch = dataset.sample([0, 7], {"action": range(20)})                       # doctest: +SKIP
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from roboverse_learn.data.collection.collect import CollectionProgress, CollectionSummary, collect
    from roboverse_learn.data.collection.config import CollectionConfig
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

_MODULES = {
    "collection.collect": ("CollectionProgress", "CollectionSummary", "collect"),
    "collection.config": ("CollectionConfig",),
    "dataset.info": ("DatasetInfo",),
    "dataset.merge": ("consolidate", "merge"),
    "dataset.raw": ("dataset_hash", "read_raw"),
    "dataset.reader": ("ResidentDataset",),
    "dataset.recovery": ("recover",),
    "dataset.sampler": ("EpisodeAwareSampler",),
    "dataset.schema": ("EpisodeData", "make_features"),
    "dataset.video": ("EncoderConfig",),
    "dataset.writer": ("DatasetWriter",),
    "sources.base": ("EpisodeSource",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF[name]}"), name)


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
