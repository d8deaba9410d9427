"""Configuration of a collection."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges
from roboverse_learn.data.collection.schedule import GIVE_UP_AFTER
from roboverse_learn.data.dataset.schema import Feature
from roboverse_learn.data.dataset.video import EncoderConfig
from roboverse_learn.data.sources.base import EpisodeSource, imported


@dataclass(frozen=True, kw_only=True)
class CollectionConfig:
    """Settings of a collection.

    Attributes:
        root: The dataset's folder; an existing one is continued.
        num_episodes: Successful episodes wanted in it.
        candidates: Pool indices in the order of preference, such as a split's.
        source: ``"package.module:Class"`` of an :class:`~roboverse_learn.data.sources.base.EpisodeSource`.
        source_kwargs: Its JSON-able arguments.
        fps: Frames per second.
        features: From :func:`~roboverse_learn.data.dataset.schema.make_features`.
        robot_type: Name of the robot.
        num_workers: Processes; 1 collects in this process.
        num_encoders: Processes that encode and stage what this process collects; with 0 threads do.
        batch_size: Pool episodes that a worker runs at once, such as the number of its environments.
        settings: JSON-able; what continuing the dataset must have in common with its beginning, such as
            task, level, seed. ``source_kwargs`` by default.
        encoder: Video settings.
        fewer_ok: Once every candidate was tried, fewer successes than ``num_episodes`` are a result too.
        give_up_after: Failures of a call before it may end because too few episodes succeed.
    """

    root: str | Path
    num_episodes: int
    candidates: Sequence[int]
    source: str
    source_kwargs: Mapping[str, Any]
    fps: int
    features: Mapping[str, Feature]
    robot_type: str | None = None
    num_workers: int = 1
    num_encoders: int = 0
    batch_size: int = 1
    settings: Mapping[str, Any] | None = None
    encoder: EncoderConfig = field(default_factory=EncoderConfig)
    fewer_ok: bool = False
    give_up_after: int = GIVE_UP_AFTER

    def __post_init__(self) -> None:
        check_ranges(self, from_1=("num_episodes", "num_workers", "batch_size"))
        if len(set(self.candidates)) != len(self.candidates):
            raise ConfigError("The candidates name a pool episode twice. Give each index once.")

    def make_source(self) -> EpisodeSource:
        """Returns the source.

        Raises:
            DatasetError: There is no such source.
        """
        return imported(self.source)(**self.source_kwargs)
