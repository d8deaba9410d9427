"""Demonstrations made from a few others: their pieces moved with the objects, and replayed in physics."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, override

from envs.core.atomic import write_json
from roboverse_learn.data.augmentation.config import AugmentConfig
from roboverse_learn.data.dataset.damage import read_json
from roboverse_learn.data.dataset.schema import EpisodeData
from roboverse_learn.data.sources.base import DemonstrationSource, Progress
from roboverse_learn.data.sources.expert import ExpertEpisodes
from roboverse_learn.data.sources.made_from import refuse_changed_origin

_LOG = logging.getLogger(__name__)

AUGMENT_PATH = "meta/augment.json"
"""File of a generated dataset with what its source demonstrations do, and which of them were left out."""


class AugmentSource(DemonstrationSource):
    """``source=augment``."""

    episodes: ClassVar = "roboverse_learn.data.sources.augment:AugmentEpisodes"
    augments: ClassVar = True
    needs: ClassVar = {
        "from_dataset": "<folder>: a dataset of demonstrations, as in from=datasets/PickCube/<name>."
    }

    @classmethod
    @override
    def task_of(cls, values: Mapping[str, Any]) -> str | None:
        from roboverse_learn.data.dataset.recorded_scene import task_of

        return task_of(values["from_dataset"]) if values["from_dataset"] else None

    @cached_property
    def found(self) -> Any:
        """The :class:`~roboverse_learn.data.augmentation.sources.SourceSet` of the dataset."""
        from roboverse_learn.data.augmentation.sources import read_sources

        return read_sources(self.config.from_dataset, self.config.env.make_task(), self.config.augment)

    @override
    def check(self) -> None:
        """Reads the source demonstrations, and finds their pieces."""
        if self.found.left_out:
            _LOG.warning("%s", self.found)

    @override
    def prepare(self, dataset: Path, progress: Progress) -> None:
        """Refuses a dataset that was made when the source demonstrations were others."""
        made = read_json(dataset / AUGMENT_PATH) if (dataset / AUGMENT_PATH).is_file() else {}
        then = sum(len(made.get(key, ())) for key in ("demonstrations", "left_out"))
        now = len(self.found.sources) + len(self.found.left_out)
        origin = self.config.from_dataset
        refuse_changed_origin(dataset, self.identity(), "sources", origin, then=then, now=now)

    @override
    def name_part(self) -> str:
        from roboverse_learn.data.augmentation.sources import digest_of

        options, usual = self.config.augment, AugmentConfig()
        changed = [
            f"{item.name}={getattr(options, item.name)}"
            for item in fields(AugmentConfig)
            if getattr(options, item.name) != getattr(usual, item.name)
        ]
        return "-".join(["augment", digest_of(self.config.from_dataset, options.num_sources)[:8], *changed])

    @override
    def identity(self) -> dict[str, Any]:
        return {"source": "augment", "sources": self.found.digest, "augment": asdict(self.config.augment)}

    @override
    def candidates(self) -> list[int]:
        return [index for index in super().candidates() if index not in self.found.own_episodes]

    @override
    def arguments(self) -> dict[str, Any]:
        return super().arguments() | {
            "dataset": str(Path(self.config.from_dataset).resolve()),
            "augment": asdict(self.config.augment),
        }

    @override
    def outcome(self, num_kept: int, num_attempts: int) -> str:
        return (
            f"{num_kept} of {num_attempts} attempts were kept ({100 * num_kept / max(num_attempts, 1):.1f} %)"
        )

    @override
    def advice_for_task(self) -> str:
        return (
            "Give more or other source demonstrations, augment.noise_m=0, a slower augment.bridge_speed_m_s, "
            "or a smaller num_demos."
        )

    @override
    def finish(self, dataset: Path) -> None:
        """Writes what the source demonstrations do into the dataset."""
        found = self.found
        write_json(
            dataset / AUGMENT_PATH,
            {
                **self.identity(),
                "sequence": found.sequence,
                "demonstrations": [source.demo.index for source in found.sources],
                "left_out": {str(index): words for index, words in found.left_out.items()},
            },
        )


class AugmentEpisodes(ExpertEpisodes):
    """Generates episodes in a batch of environments of the train split.

    Args:
        dataset: Folder of the source demonstrations.
        augment: Values of an :class:`~roboverse_learn.data.augmentation.config.AugmentConfig`.
        scene: See :class:`~roboverse_learn.data.sources.expert.ExpertEpisodes`.
    """

    def __init__(self, *, dataset: str, augment: Mapping[str, Any], **scene: Any) -> None:
        from roboverse_learn.data.augmentation.planner import AugmentPlanner
        from roboverse_learn.data.augmentation.sources import read_sources

        super().__init__(**scene)
        config = AugmentConfig(**augment)
        found = read_sources(dataset, self._env.task, config)
        self._planner = AugmentPlanner(self._env.task, found.sources, config)
        self._max_retries, self._digest = config.retries, found.digest

    @override
    def attempts(self, indices: Sequence[int]) -> Iterator[tuple[int, EpisodeData | None]]:
        from roboverse_learn.data.augmentation.actor import augmented_episodes

        for outcome in augmented_episodes(self._env, list(indices), self._planner, self._max_retries):
            made = outcome.memory
            facts = {
                "source": "augment",
                "sources": self._digest,
                "pieces": [piece._asdict() for piece in made.made_of],
                "attempts": 1 + made.retries,
            }
            yield int(outcome.episode), self._episode(outcome, **facts) if outcome.success else None
