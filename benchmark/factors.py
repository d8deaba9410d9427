"""What breaks a policy: success by what was drawn for each episode of a results file.

``python -m benchmark.factors results=results/v2/NutAssembly/act/<run>.json level=3`` draws the starts and the
looks of the episodes again, without simulating or rendering anything, and compares the episodes in which a
number was low with those in which it was high. Of a surface's texture the numbers are its brightness, its
contrast and its colour. A factor that stands out is a place to look, and no proof: factors may go together.

Thirds are those of each split, and episodes of one split are compared with each other alone: looks and
success both differ between splits. An episode that several files have counts once, with the share of them in
which it succeeded.
"""

import logging
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.records import EpisodeRecord, Result
from benchmark.results import read_result
from benchmark.statistics import CONFIDENCE
from envs.core.arguments import run_program
from envs.core.errors import ConfigError
from envs.randomization import MaterialLibrary
from envs.randomization.camera_poses import CAMERA_POSES
from envs.randomization.seeding import channel_rng

logger = logging.getLogger(__name__)

_COMMAND = "python -m benchmark.factors"

LEAST_EPISODES = 30
"""Episodes, of one level, below which thirds of them say nothing."""

_TEXTURE_PX = 128


@dataclass(frozen=True, kw_only=True, slots=True)
class FactorSettings:
    """Settings of the command.

    Attributes:
        results: Results files of one task; their episodes are counted together.
        level: The level whose episodes are compared.
        splits: Splits whose episodes are compared.
        materials: What the evaluation was given as ``materials=``; empty for the built-in ones.
        shown: Factors that are shown, those that stand out most.
    """

    results: tuple[Path, ...] = ()
    level: int = 3
    splits: tuple[str, ...] = ("train", "test")
    materials: str = ""
    shown: int = 12


@dataclass(frozen=True, kw_only=True, slots=True)
class Factor:
    """Success in about the lowest and the highest third of the episodes by one number; ties stay together.

    Attributes:
        name: The number, such as ``environment.table contrast``.
        means: Mean of the number in the lowest third and in the highest.
        low: Mean success and episodes of the lowest third.
        high: Mean success and episodes of the highest third.
        p_value: Of the difference, two-sided, times the number of factors (Bonferroni), at most 1; see
            :func:`compared`.
    """

    name: str
    means: tuple[float, float]
    low: tuple[float, int]
    high: tuple[float, int]
    p_value: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Drawn:
    """One episode.

    Attributes:
        split: Its split.
        success: Share of its runs that succeeded.
        numbers: What was drawn for it, by name.
    """

    split: str
    success: float
    numbers: Mapping[str, float]


def main(words: Sequence[str] | None = None) -> int:
    """Prints the factors of some results; returns the exit code."""

    def run(settings: FactorSettings) -> None:
        factors = factors_of(settings)
        logger.info("%s", "\n".join(_lines(factors[: settings.shown])))
        clear = sum(factor.p_value < 1.0 - CONFIDENCE for factor in factors)
        logger.info("%d of %d factors stand out (p < 0.05 after Bonferroni).", clear, len(factors))

    return run_program(_COMMAND, FactorSettings, run, words)


def factors_of(settings: FactorSettings) -> list[Factor]:
    """Returns all factors of the episodes, those that stand out most first.

    Raises:
        ConfigError: No file is given, they are of several tasks or scenes, have too few episodes, or the
            materials are not those of the evaluation.
        ResultError: A file is damaged.
    """
    results = [read_result(path) for path in settings.results]
    if not results:
        raise ConfigError("Name the results: results=results/v2/<task>/<policy>/<run>.json.")
    if any(_scene(result) != _scene(results[0]) for result in results):
        raise ConfigError(
            "Results of several tasks, scenes or protocols share no factors. Give those of one."
        )
    _check_materials(results[0].env.materials, settings.materials)
    succeeded: dict[tuple[str, int], list[bool]] = {}
    for record in (record for result in results for record in result.records):
        if _is_plain(record) and record.level == settings.level and record.split in settings.splits:
            succeeded.setdefault((record.split, record.episode), []).append(record.success)
    if len(succeeded) < LEAST_EPISODES:
        raise ConfigError(
            f"{len(succeeded)} episodes are of level={settings.level} splits=[{','.join(settings.splits)}], "
            f"and {LEAST_EPISODES} are needed. There are {_at_hand(results)}. Give level= and splits= of "
            "these, or evaluate more episodes."
        )
    drawn = _drawn(results[0], settings, sorted(succeeded))
    return compared([
        Drawn(split=split, success=float(np.mean(succeeded[split, episode])), numbers=numbers)
        for (split, episode), numbers in drawn.items()
    ])  # fmt: skip


def compared(episodes: Sequence[Drawn]) -> list[Factor]:
    """Returns a factor for each number that varies in all episodes, those that stand out most first.

    The test is that of Cochran, Mantel and Haenszel with a stratum for each split (Mantel and Haenszel 1959,
    Journal of the National Cancer Institute 22:719-748), without a correction for continuity: the mean
    difference of success against its variance when the episodes of a split are exchanged at random.
    """
    from scipy.stats import norm

    names = [name for name in episodes[0].numbers if all(name in each.numbers for each in episodes)]
    found = [(name, *each) for name in names if (each := _thirds(name, episodes)) is not None]
    by_p = []
    for name, low, high in found:
        weights, differences, variances = [], [], []
        for split in {each.split for each in (*low, *high)}:
            a, b = (
                np.array([each.success for each in third if each.split == split]) for third in (low, high)
            )
            weights.append(len(a) * len(b) / (len(a) + len(b)))
            differences.append(b.mean() - a.mean())
            variances.append(np.concatenate([a, b]).var(ddof=1) * (1 / len(a) + 1 / len(b)))
        spread = float(np.sqrt(np.square(weights) @ np.array(variances)))
        p = 2.0 * float(norm.sf(abs(np.dot(weights, differences)) / spread)) if spread else 1.0
        factor = Factor(
            name=name,
            means=(_mean(low, name), _mean(high, name)),
            low=(float(np.mean([each.success for each in low])), len(low)),
            high=(float(np.mean([each.success for each in high])), len(high)),
            p_value=min(1.0, p * len(found)),
        )
        by_p.append((p, name, factor))
    return [factor for *_, factor in sorted(by_p, key=lambda each: each[:2])]


def _thirds(name: str, episodes: Sequence[Drawn]) -> tuple[list[Drawn], list[Drawn]] | None:
    """Returns the lowest and the highest third of each split by a number; None where it varies in none."""
    low, high = [], []
    for split in sorted({each.split for each in episodes}):
        of_split = [each for each in episodes if each.split == split]
        values = np.array([each.numbers[name] for each in of_split], dtype=np.float64)
        if np.ptp(values) == 0.0:
            continue
        below, above = np.quantile(values, (1 / 3, 2 / 3))
        in_low, in_high = values <= below, values >= above
        if below == above:  # most are one value: against those on its one side
            in_high = values > below if below < values.max() else in_high
            in_low = ~in_high
        low += [each for each, chosen in zip(of_split, in_low, strict=True) if chosen]
        high += [each for each, chosen in zip(of_split, in_high, strict=True) if chosen]
    return (low, high) if low else None


def _mean(episodes: Sequence[Drawn], name: str) -> float:
    return float(np.mean([each.numbers[name] for each in episodes]))


def _scene(result: Result) -> tuple[Any, ...]:
    """Returns what decides the draws of an episode."""
    env, protocol = result.env, result.protocol
    return (
        env.task,
        env.task_kwargs,
        env.robot,
        env.scenario,
        env.materials,
        protocol.version,
        protocol.seed,
    )


def _check_materials(recorded: str, given: str) -> None:
    """Checks that the materials are those of the evaluation.

    Args:
        recorded: Those of the result: empty, or the folder's name and the first digits of its content's hash.
        given: Those of the command.
    """
    own = MaterialLibrary.chosen(given).digest()[:8] if given else ""
    if recorded.rpartition("-")[2] == own and recorded.startswith("+") == given.startswith("+"):
        return
    from_what = f"the materials '{recorded}'" if recorded else "the built-in materials"
    raise ConfigError(
        f"The episodes were drawn from {from_what}, given materials={given or 'none'}. Give the same."
    )


def _is_plain(record: EpisodeRecord) -> bool:
    return record.level is not None and record.only is None and record.instruction_test is None


def _at_hand(results: Sequence[Result]) -> str:
    """Returns ``100 of level 0 train, 100 of level 0 test``."""
    plain = [record for result in results for record in result.records if _is_plain(record)]
    counts = Counter((record.level, record.split) for record in plain)
    return (
        ", ".join(f"{count} of level {level} {split}" for (level, split), count in counts.items()) or "none"
    )


def _drawn(
    result: Result, settings: FactorSettings, episodes: Sequence[tuple[str, int]]
) -> dict[tuple[str, int], dict[str, float]]:
    """Returns the numbers of episodes by their split and index.

    The simulator and the cameras' sizes decide nothing that is drawn, so the scene is made in ``mujoco``.
    """
    spec = result.env.replace(
        level=settings.level,
        only=None,
        simulator="mujoco",
        simulator_settings={},
        materials=settings.materials,
    )
    found: dict[tuple[str, int], dict[str, float]] = {}
    for split in sorted({split for split, _ in episodes}):
        env = spec.make(1, split=split, observation="state", protocol_seed=result.protocol.seed)
        try:
            for episode in [index for name, index in episodes if name == split]:
                rng = channel_rng(result.protocol.seed, "task", episode)
                start = env.task.initial_state([rng])
                numbers = dict(_start(start.objects))
                numbers |= _numbers(env.randomizer.draws(episode), env.randomizer.library)
                found[split, episode] = numbers
        finally:
            env.close()
    return found


def _start(objects: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    """Yields where each object starts: metres in the world, and its turn about the vertical, rad."""
    for name, state in objects.items():
        for axis, value in zip("xyz", state.pos[0].tolist(), strict=True):
            yield f"start.{name} {axis}_m", value
        w, x, y, z = state.rot[0].tolist()
        yield f"start.{name} yaw_rad", float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def _numbers(draws: Mapping[str, Any], library: Any) -> dict[str, float]:
    """Returns the numbers of draws by name: those drawn, and those of named textures and poses."""
    found: dict[str, float] = {}
    for name, value in _leaves(draws):
        if isinstance(value, str) and value in CAMERA_POSES:
            found[f"{name} azimuth_deg, to either side"] = abs(CAMERA_POSES[value].azimuth_deg)
            found[f"{name} polar_deg"] = CAMERA_POSES[value].polar_deg
        elif isinstance(value, str) and ".textures." in name:
            surface = name.replace(".textures.", ".")
            found |= {f"{surface} {fact}": number for fact, number in _texture(library, value).items()}
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[name] = value
    return found


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields what is no section, by its dotted name; lists, such as the furniture, are left out."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        elif not isinstance(value, Sequence) or isinstance(value, str):
            yield f"{prefix}{key}", value


@cache
def _texture(library: Any, name: str) -> dict[str, float]:
    """Returns mean and spread of a texture's luma (BT.601), and how coloured it is, each from 0 to 1."""
    pixels = library.texture(name, _TEXTURE_PX)[..., :3].reshape(-1, 3) / 255.0
    luma, mean = pixels @ (0.299, 0.587, 0.114), pixels.mean(0)
    return {
        "brightness": float(luma.mean()),
        "contrast": float(luma.std()),
        "colour": float(mean.max() - mean.min()),
    }


def _lines(factors: Sequence[Factor]) -> list[str]:
    rows = [("factor", "low", "success there", "high", "success there", "p")]
    for factor in factors:
        low, high = factor.means
        p = "< 0.001" if factor.p_value < 0.001 else f"{factor.p_value:.3f}"
        rows.append((factor.name, f"{low:.3g}", _rate(*factor.low), f"{high:.3g}", _rate(*factor.high), p))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def _rate(success: float, episodes: int) -> str:
    return f"{100 * success:.0f} % of {episodes}"


if __name__ == "__main__":
    sys.exit(main())
