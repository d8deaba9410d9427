"""Records of an evaluation: an episode, the summary of a cell, and the whole run."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from typing import Any

from benchmark.protocol import Cell, Protocol
from benchmark.statistics import confidence_sequence, narrow_after, wilson
from envs.core.errors import ResultError
from envs.spec import EnvSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class EpisodeRecord:
    """One episode.

    Attributes:
        task: Task.
        policy: Policy.
        level: Level, or None when one channel varied alone.
        only: The channel that varied alone, or None.
        channels: Every channel that varied.
        split: One of :data:`~envs.randomization.splits.SPLIT_NAMES`.
        episode: Index in the task's pool of episodes.
        seed: The protocol's seed, from which the episode follows.
        initial_state_hash: Hash of the initial state and appearance: equal for the same episode.
        success: Whether the task's success criterion was met.
        length: Control steps.
        episode_return: Sum of the rewards, undiscounted.
        wall_time_s: The episode's share of the clock; those of a cell add up to the cell's time.
        simulator: Simulator.
        renderer: Renderer of the images.
        not_shown: Properties that varied and that the renderer cannot show.
        versions: Versions of the packages that decide the outcome.
        instruction_test: One of :data:`~benchmark.protocol.INSTRUCTION_TESTS`, or None.
        instruction: What the policy was asked, at first; None in a file that is older than this field.
        switched_at: The control step before which the instruction was switched, or None.
        switched_to: What the policy was asked from then on, or None.
    """

    task: str
    policy: str
    level: int | None = None
    only: str | None = None
    channels: tuple[str, ...]
    split: str
    episode: int
    seed: int
    initial_state_hash: str
    success: bool
    length: int
    episode_return: float
    wall_time_s: float
    simulator: str
    renderer: str
    not_shown: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    instruction_test: str | None = None
    instruction: str | None = None
    switched_at: int | None = None
    switched_to: str | None = None

    @property
    def cell(self) -> Cell:
        """The cell that the episode belongs to; one object for all of its episodes."""
        return _cell(self.level, self.only, self.split, self.instruction_test)

    def to_json(self) -> dict[str, Any]:
        """Returns every field as plain JSON values: one line of a log of records."""
        return asdict(self) | {"channels": list(self.channels), "not_shown": list(self.not_shown)}

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> "EpisodeRecord":
        """Returns the record of :meth:`to_json`.

        Raises:
            KeyError: A list is absent.
            TypeError: A field is absent, or there is one too many.
        """
        lists = {name: tuple(values[name]) for name in ("channels", "not_shown")}
        return cls(**{**values, **lists})


@lru_cache(typed=True)
def _cell(level: int | None, only: str | None, split: str, test: str | None) -> Cell:
    return Cell(level=level, only=only, split=split, instruction_test=test)


@dataclass(frozen=True, kw_only=True, slots=True)
class CellSummary:
    """Summary of the episodes of one cell.

    Attributes:
        cell: The cell.
        channels: Channels that varied.
        not_shown: Properties that varied and that the renderer cannot show.
        episodes: Number of episodes.
        successes: How many succeeded.
        success_rate: Their share.
        ci_low: Lower end of the 95 % interval: Wilson's, or the one that allows to stop early.
        ci_high: Upper end.
        mean_length: Mean length, control steps.
        mean_return: Mean undiscounted return.
    """

    cell: Cell
    channels: tuple[str, ...]
    not_shown: tuple[str, ...]
    episodes: int
    successes: int
    success_rate: float
    ci_low: float
    ci_high: float
    mean_length: float
    mean_return: float

    def to_json(self) -> dict[str, Any]:
        """Returns plain JSON values."""
        values = {name: getattr(self, name) for name in self.__slots__ if name != "cell"}
        values |= {"channels": list(self.channels), "not_shown": list(self.not_shown)}
        return self.cell.to_json() | values


@dataclass(frozen=True, kw_only=True, slots=True)
class Checkpoint:
    """Evaluated checkpoint, and the rule that chose it.

    Attributes:
        choice: Always ``"last"``: choosing the best by its results would measure the luck of the choice.
        step: Training step of the checkpoint, or None when nothing was trained.
        hash: SHA-256 of the file of weights, or None when there is none.
    """

    choice: str = "last"
    step: int | None = None
    hash: str | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Git:
    """The checkout that ran: its commit, and whether files other than results differed from it."""

    sha: str
    dirty: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Machine:
    """Machine that it ran on, without names of hosts or folders."""

    device: str
    cpu_count: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """One evaluation of one checkpoint: everything that its results file holds.

    Attributes:
        run: Name of the run, unique for a policy and task.
        created: When, ``YYYY-MM-DDThh:mm:ssZ``.
        protocol: Levels, splits and episodes.
        env: Environment. Its level and channel are those of each cell, and its materials are recorded by the
            folder's name and the first digits of its content's SHA-256, as in ``+images-1a2b3c4d``.
        sees_images: Whether the policy observes images; otherwise ``env.cameras`` is empty.
        max_episode_steps: Length at which an episode is truncated, control steps.
        control_hz: Control steps per second.
        policy: Policy.
        train_tasks: Tasks that one policy learned together, or the one that it learned where this is another;
            empty where it learned this one alone, or nothing is known.
        train_level: Level of the demonstrations, or None.
        train_only: The channel that varied alone in training, or None.
        recipe: Name of the recipe that it was trained by, version included; empty without one.
        seed: Seed of the training run.
        checkpoint: Which checkpoint.
        dataset_hash: Hash of the training data, or None when nothing was trained.
        demonstrations: Episodes of the training data, or None when nothing was trained.
        git: The checkout, or None outside one.
        command: The command line.
        config: The resolved configuration, plain JSON values.
        machine: Device and number of CPU cores.
        versions: Versions of the packages that decide the outcome.
        records: Every episode.
    """

    run: str
    created: str
    protocol: Protocol
    env: EnvSpec
    sees_images: bool = True
    max_episode_steps: int
    control_hz: float
    policy: str
    train_tasks: tuple[str, ...] = ()
    train_level: int | None
    train_only: str | None = None
    recipe: str = ""
    seed: int
    checkpoint: Checkpoint = field(default_factory=Checkpoint)
    dataset_hash: str | None
    demonstrations: int | None
    git: Git | None
    command: str
    config: Mapping[str, Any] = field(default_factory=dict)
    machine: Machine
    versions: Mapping[str, str] = field(default_factory=dict)
    records: tuple[EpisodeRecord, ...]

    def cells(self) -> tuple[CellSummary, ...]:
        """Returns the summary of every cell, in the protocol's order.

        Raises:
            ResultError: The records are not exactly those of the protocol.
        """
        check_complete(self.protocol, self.records)
        return summarize(self.records, stopped_early=self.protocol.width is not None)


def by_cell(records: Iterable[EpisodeRecord]) -> dict[Cell, list[EpisodeRecord]]:
    """Returns the episodes of every cell, the cells in the order in which they first appear."""
    groups: dict[Cell, list[EpisodeRecord]] = {}
    for record in records:
        groups.setdefault(record.cell, []).append(record)
    return groups


def summarize(records: Iterable[EpisodeRecord], *, stopped_early: bool = False) -> tuple[CellSummary, ...]:
    """Returns the summary of every cell, in the order in which the cells first appear.

    Args:
        records: Episodes.
        stopped_early: Whether the outcomes decided how many episodes a cell has.

    Raises:
        ResultError: The records of one cell disagree on what varied, or hold a number that is not finite.
    """
    interval = confidence_sequence if stopped_early else wilson
    return tuple(_summarize_cell(cell, members, interval) for cell, members in by_cell(records).items())


def _summarize_cell(
    cell: Cell,
    records: Sequence[EpisodeRecord],
    interval: Callable[[int, int], tuple[float, float]],
) -> CellSummary:
    if len({(record.channels, record.not_shown) for record in records}) != 1:
        raise ResultError(f"The episodes of {cell} disagree on which channels varied or could be shown.")
    for record in records:
        if not (math.isfinite(record.episode_return) and math.isfinite(record.wall_time_s)):
            raise ResultError(
                f"Episode {record.episode} of {cell} has a return of {record.episode_return} and took "
                f"{record.wall_time_s} s; both must be finite. Check the task's reward."
            )
    successes, n = sum(record.success for record in records), len(records)
    low, high = interval(successes, n)
    return CellSummary(
        cell=cell,
        channels=records[0].channels,
        not_shown=records[0].not_shown,
        episodes=n,
        successes=successes,
        success_rate=successes / n,
        ci_low=low,
        ci_high=high,
        mean_length=sum(record.length for record in records) / n,
        mean_return=math.fsum(record.episode_return for record in records) / n,
    )


def check_complete(protocol: Protocol, records: Sequence[EpisodeRecord]) -> None:
    """Checks that the records are exactly those of a protocol.

    Raises:
        ResultError: A cell is missing or extra, has another number of episodes, an episode twice, or
            other episodes than another cell of its split.
    """
    groups = by_cell(records)
    missing = [str(cell) for cell in protocol.cells() if cell not in groups]
    extra = [str(cell) for cell in groups if cell not in protocol.cells()]
    if missing or extra:
        raise ResultError(
            f"The protocol's cells and the records' differ: missing {'; '.join(missing) or 'none'}, "
            f"unexpected {'; '.join(extra) or 'none'}."
        )
    indices = {cell: [record.episode for record in members] for cell, members in groups.items()}
    for cell, episodes in indices.items():
        needed = protocol.episodes
        if protocol.width is not None:
            needed = narrow_after([record.success for record in groups[cell]], protocol.width) or needed
        if len(episodes) != needed or len(set(episodes)) != len(episodes):
            raise ResultError(
                f"{str(cell).capitalize()} has {len(episodes)} records of {len(set(episodes))} episodes; the "
                f"protocol needs {needed}, each once."
            )
    for split in protocol.splits:
        of_split = [episodes for cell, episodes in indices.items() if cell.split == split]
        longest = max(of_split, key=len)
        if any(set(episodes) != set(longest[: len(episodes)]) for episodes in of_split):
            raise ResultError(f"The cells of the {split} split are not of the same episodes.")
