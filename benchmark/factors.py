"""What breaks a policy: success by what was drawn for each episode of a results file.

``python -m benchmark.factors results=results/v2/NutAssembly/act/<run>.json level=3`` draws the starts and the
looks of the episodes again, without simulating or rendering anything, and compares the episodes in which a
number was low with those in which it was high. Of a surface's texture the numbers are its brightness, its
contrast and its colour. A factor that stands out is a place to look, and no proof: factors may go together.
"""

import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.records import EpisodeRecord, Result
from benchmark.results import read_result
from benchmark.statistics import CONFIDENCE, wilson
from envs.core.arguments import run_program
from envs.core.errors import ConfigError
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
    """Success in the lowest and in the highest third of the episodes by one number.

    Attributes:
        name: The number, such as ``environment.table contrast``.
        bounds: Largest number of the lowest third, and smallest of the highest.
        low: Successes and episodes of the lowest third.
        high: Successes and episodes of the highest third.
        p_value: Fisher's exact test of the two thirds, two-sided, times the number of factors (Bonferroni),
            at most 1.
    """

    name: str
    bounds: tuple[float, float]
    low: tuple[int, int]
    high: tuple[int, int]
    p_value: float


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
        ConfigError: No file is given, they are of several tasks or protocols, or have too few episodes.
        ResultError: A file is damaged.
    """
    results = [read_result(path) for path in settings.results]
    if not results:
        raise ConfigError("Name the results: results=results/v2/<task>/<policy>/<run>.json.")
    if len({(result.env.task, result.protocol.version, result.protocol.seed) for result in results}) > 1:
        raise ConfigError("Results of several tasks or protocols share no factors. Give those of one.")
    chosen = [record for result in results for record in _of_level(result, settings)]
    if len(chosen) < LEAST_EPISODES:
        levels = sorted({record.level for result in results for record in result.records
                         if record.level is not None})  # fmt: skip
        raise ConfigError(
            f"{len(chosen)} episodes are of level={settings.level} splits=[{','.join(settings.splits)}], and "
            f"{LEAST_EPISODES} are needed. The files have levels {', '.join(map(str, levels)) or 'none'}."
        )
    if (recorded := results[0].env.materials) and not settings.materials:
        raise ConfigError(
            f"The episodes were drawn from the materials '{recorded}'. Give materials=<folder>."
        )
    drawn = _drawn(results[0], settings, sorted({(record.split, record.episode) for record in chosen}))
    rows = [drawn[record.split, record.episode] for record in chosen]
    return compared(rows, [record.success for record in chosen])


def compared(rows: Sequence[Mapping[str, float]], successes: Sequence[bool]) -> list[Factor]:
    """Returns a factor for each number that varies in all episodes, those that stand out most first.

    Args:
        rows: Numbers of each episode by name.
        successes: Whether the episode succeeded.
    """
    from scipy.stats import fisher_exact

    names = [name for name in rows[0] if all(name in row for row in rows)]
    values = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}
    varying = {name: each for name, each in values.items() if np.ptp(each) > 0.0}
    won = np.asarray(successes, dtype=bool)
    by_p = []
    for name, each in varying.items():
        below, above = np.quantile(each, (1 / 3, 2 / 3))
        low, high = won[each <= below], won[each >= above]
        table = [[int(low.sum()), int((~low).sum())], [int(high.sum()), int((~high).sum())]]
        test: Any = fisher_exact(table)
        p = float(test.pvalue)
        factor = Factor(
            name=name,
            bounds=(float(below), float(above)),
            low=(table[0][0], len(low)),
            high=(table[1][0], len(high)),
            p_value=min(1.0, p * len(varying)),
        )
        by_p.append((p, name, factor))
    return [factor for *_, factor in sorted(by_p, key=lambda each: each[:2])]


def _of_level(result: Result, settings: FactorSettings) -> list[EpisodeRecord]:
    return [
        record for record in result.records
        if record.level == settings.level and record.only is None and record.split in settings.splits
        and record.instruction_test is None
    ]  # fmt: skip


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
        low, high = factor.bounds
        p = "< 0.001" if factor.p_value < 0.001 else f"{factor.p_value:.3f}"
        rows.append(
            (factor.name, f"<= {low:.3g}", _rate(*factor.low), f">= {high:.3g}", _rate(*factor.high), p)
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]


def _rate(successes: int, episodes: int) -> str:
    low, high = wilson(successes, episodes)
    return f"{100 * successes / episodes:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


if __name__ == "__main__":
    sys.exit(main())
