"""A dataset that was made from another one, which may have grown or changed since."""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, override

from envs.core.errors import DatasetError
from roboverse_learn.data.collection.schedule import read_record
from roboverse_learn.data.dataset.info import is_collected_here, read_info
from roboverse_learn.data.sources.base import DemonstrationSource, Progress


class MadeFromDataset(DemonstrationSource):
    """A source whose demonstrations are those of another dataset, all of which decides what is made."""

    @cached_property
    def _origin_hash(self) -> str:
        from roboverse_learn.data.dataset.raw import dataset_hash

        return dataset_hash(self.config.from_dataset)[:16]

    @override
    def prepare(self, dataset: Path, progress: Progress) -> None:
        """Refuses a dataset that was made when the other one was another."""
        origin = self.config.from_dataset
        now = read_info(Path(origin))["total_episodes"]
        refuse_changed_origin(dataset, self.identity(), "dataset", origin, now=now)

    @override
    def name_part(self) -> str:
        return f"{self.config.source}-{Path(self.config.from_dataset).name}"

    @override
    def identity(self) -> dict[str, Any]:
        return {"source": self.config.source, "dataset": self._origin_hash}


def refuse_changed_origin(
    dataset: Path, identity: Mapping[str, Any], key: str, origin: str, *, then: int = 0, now: int
) -> None:
    """Checks that a dataset that is continued was made from what its origin holds now.

    Args:
        dataset: Folder of the dataset, which may not exist yet.
        identity: :meth:`~roboverse_learn.data.sources.base.DemonstrationSource.identity` of its source.
        key: Entry of it that names what the origin holds.
        origin: Folder of the origin, as it is given.
        then: Demonstrations that the dataset was made from; 0 where nothing says it.
        now: Demonstrations that the origin has.

    Raises:
        DatasetError: It was made from others.
    """
    if not is_collected_here(dataset) or not read_info(dataset)["total_episodes"]:
        return
    before, _ = read_record(dataset)
    if before.get("source") != identity["source"] or before.get(key) == identity[key]:
        return
    what = "has grown since" if 0 < then < now else "has changed since, or is another dataset"
    numbers = f"{then} demonstrations then, {now} now" if then else f"{now} demonstrations now"
    raise DatasetError(
        f"The dataset '{dataset}' was made from other demonstrations: from={origin} {what} ({numbers}). Name "
        f"another folder with dataset=<folder>, or remove '{dataset}' to make it anew."
    )
