"""Configuration of ``roboverse view``."""

from dataclasses import dataclass, field
from typing import Literal

from envs.core.errors import ConfigError
from envs.core.ranges import check_ranges
from envs.spec import EnvSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class ViewConfig:
    """``roboverse view``: one episode in the Rerun viewer: 3D scene over time, images, randomization draws.

    Attributes:
        env: Environment of the task's expert. Its fields are typed without ``env.``: ``task=PickCube``.
        dataset: Folder of a dataset that was collected here; views a recorded episode instead.
        result: Results file of an evaluation; views one of its videos instead.
        episode: Which episode of the split or the dataset, or which of the result's videos, from 0.
        split: Split of the expert's episode.
        protocol_seed: Seed of the expert's episode.
        file: Recording to write, such as ``episode.rrd``; empty opens the browser. Without a display, the
            file is view.rrd.
    """

    env: EnvSpec = field(default_factory=EnvSpec)
    dataset: str = ""
    result: str = ""
    episode: int = 0
    split: Literal["train", "test"] = "train"
    protocol_seed: int = 0
    file: str = ""

    def __post_init__(self) -> None:
        check_ranges(self, from_0=("episode", "protocol_seed"))
        given = [f"{key}={getattr(self, key)}" for key in ("dataset", "result") if getattr(self, key)]
        if given and (len(given) > 1 or self.env.replace(materials="") != EnvSpec()):
            raise ConfigError(
                f"{' and '.join(given)} cannot be combined with others: view takes dataset=, result=, "
                "or the keys of an environment, such as task= and level=. Give one of them."
            )
        if self.file and not self.file.endswith(".rrd"):
            raise ConfigError(f"file={self.file} must end in .rrd, the format of the Rerun viewer.")
