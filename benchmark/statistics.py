"""Intervals, aggregates and paired tests of success rates: pure functions of numbers.

Every random estimate takes a seed.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

CONFIDENCE = 0.95


@dataclass(frozen=True, kw_only=True, slots=True)
class PairedTest:
    """Two policies on the same episodes.

    Attributes:
        num_episodes: Episodes both were run on.
        both: Episodes where both succeed.
        only_a: Episodes where only the first succeeds.
        only_b: Episodes where only the second succeeds.
        neither: Episodes where both fail.
        difference: Success rate of the first minus that of the second.
        ci_low: Lower end of the interval of the difference; see :func:`paired_difference`.
        ci_high: Upper end.
        p_value: Exact McNemar test, two-sided; valid when the number of episodes was fixed beforehand.
        p_sequential: Anytime-valid p-value, which may be looked at after every episode.
        decided_after: Episodes after which ``p_sequential`` first fell to 1 - confidence, or None.
    """

    num_episodes: int
    both: int
    only_a: int
    only_b: int
    neither: int
    difference: float
    ci_low: float
    ci_high: float
    p_value: float
    p_sequential: float
    decided_after: int | None


@cache
def wilson(successes: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Returns Wilson's score interval of a success rate (Wilson 1927, doi:10.2307/2276774).

    Args:
        successes: Episodes that succeeded.
        n: Episodes in all, at least 1.
        confidence: Coverage of the interval.

    Raises:
        ValueError: ``n`` is below 1, or ``successes`` is not between 0 and ``n``.
    """
    from scipy.stats import binomtest

    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"An interval needs 0 <= successes <= n and n >= 1, given {successes} of {n}.")
    interval = binomtest(successes, n).proportion_ci(confidence_level=confidence, method="wilson")
    return float(interval.low), float(interval.high)


@cache
def confidence_sequence(successes: int, n: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Returns an interval of a success rate that stays valid whenever one stops, also by looking at it.

    With probability ``confidence`` the intervals after 1, 2, 3, … episodes all hold the rate. A rate p is
    outside once the mixture of likelihoods under a uniform prior, ``B(s + 1, f + 1)``, is ``1 / alpha``
    times its own, ``p**s * (1 - p)**f``: a martingale under p, so Ville's inequality bounds it (Robbins
    1970, doi:10.1214/aoms/1177696786; Howard et al. 2021, arXiv:1810.08240). It is wider than
    :func:`wilson`, which is valid for a number of episodes that was fixed beforehand.

    Args:
        successes: Episodes that succeeded.
        n: Episodes so far, at least 1.
        confidence: Coverage of all intervals together.

    Raises:
        ValueError: ``n`` is below 1, or ``successes`` is not between 0 and ``n``.
    """
    from scipy.optimize import root_scalar
    from scipy.special import betaln, xlog1py, xlogy

    if n < 1 or not 0 <= successes <= n:
        raise ValueError(f"An interval needs 0 <= successes <= n and n >= 1, given {successes} of {n}.")
    failures, rate = n - successes, successes / n
    least = betaln(successes + 1, failures + 1) + np.log(1.0 - confidence)

    def excess(p: float) -> float:
        return float(xlogy(successes, p) + xlog1py(failures, -p) - least)

    low = 0.0 if successes == 0 else root_scalar(excess, bracket=(1e-12, rate)).root
    high = 1.0 if failures == 0 else root_scalar(excess, bracket=(rate, 1.0 - 1e-12)).root
    return float(low), float(high)


def narrow_after(outcomes: Sequence[bool] | np.ndarray, width: float) -> int | None:
    """Returns the episodes after which the :func:`confidence_sequence` is first at most ``width`` wide.

    Args:
        outcomes: Whether each episode succeeded, in order.
        width: Width of the interval, in (0, 1).

    Returns:
        A number of episodes, or None where the interval is wider after all of them.
    """
    successes = 0
    for n, success in enumerate(outcomes, start=1):
        successes += bool(success)
        # Wilson's interval is narrower at every n, and in closed form.
        if np.ptp(wilson(successes, n)) <= width and np.ptp(confidence_sequence(successes, n)) <= width:
            return n
    return None


def iqm(scores: np.ndarray) -> float:
    """Returns the interquartile mean: the mean of the middle half (rliable, arXiv:2108.13264, eq. 4.1).

    Args:
        scores: Scores, (runs, cells) or any shape; a quarter is cut off either end of all of them.
    """
    from scipy.stats import trim_mean

    return float(trim_mean(np.asarray(scores, dtype=float).ravel(), proportiontocut=0.25))


def mean_of_rates(cells: Sequence[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Returns the mean of several success rates, every cell weighing the same, and its interval.

    The interval adds the squared distances to the ends of each cell's own (Zou & Donner 2008,
    doi:10.1002/sim.3095). A bootstrap would call 20 successes of 20 certain.

    Args:
        cells: Rate and both ends of its interval, of every cell.

    Returns:
        Mean, lower end, upper end.

    Raises:
        ValueError: There are no cells.
    """
    if not cells:
        raise ValueError("A mean over cells needs at least one cell.")
    rates, lows, highs = np.array(cells, dtype=float).T
    mean = float(rates.mean())
    below = float(np.sqrt(((rates - lows) ** 2).sum())) / len(cells)
    above = float(np.sqrt(((highs - rates) ** 2).sum())) / len(cells)
    return mean, max(0.0, mean - below), min(1.0, mean + above)


def mean_of_few(values: Sequence[float], confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Returns Student's t interval of the mean of a few values, such as the success rates of training runs.

    Of three values a bootstrap sees ten samples, and no value beyond them: with seeds whose own rates spread
    by 10 points its 95 % interval holds the true rate in 84 % of cases, this one in 95 %.

    Args:
        values: Two or more.
        confidence: Coverage of the interval.

    Raises:
        ValueError: There are fewer than two.
    """
    from scipy.special import stdtrit

    if len(values) < 2:
        raise ValueError(f"The spread of a mean needs at least two values, given {len(values)}.")
    error = float(np.std(values, ddof=1)) / len(values) ** 0.5
    half = float(stdtrit(len(values) - 1, 0.5 + confidence / 2.0)) * error
    mean = float(np.mean(values))
    return mean - half, mean + half


def out_to_spread(low: float, high: float, rates: Sequence[float]) -> tuple[float, float]:
    """Returns an interval of the mean of rates, each end as far out as that of :func:`mean_of_few`.

    Args:
        low: Lower end of the interval that does not know of the spread between the rates.
        high: Its upper end.
        rates: From 0 to 1; a single one has no spread.
    """
    if len(rates) < 2:
        return low, high
    between = mean_of_few(rates)
    return max(0.0, min(low, between[0])), min(1.0, max(high, between[1]))


def rate_of_runs(runs: Sequence[np.ndarray], *, stopped_early: bool = False) -> tuple[float, float, float]:
    """Returns the success rate of a method over its training runs, and its 95 % interval.

    One run: Wilson's interval. Several: whichever end is further out of Wilson's on all episodes (which
    handles 20 of 20) and Student's t over the runs' rates (which includes the variation between runs).

    Args:
        runs: Successes of every run's episodes, each (episodes,).
        stopped_early: Whether the outcomes decided how many episodes there are; the interval of a run is
            then that of :func:`confidence_sequence`, and every run weighs the same.

    Returns:
        Rate, lower end, upper end.
    """
    pooled = np.concatenate(runs)
    if stopped_early:
        rate, low, high = mean_of_rates(
            [(float(run.mean()), *confidence_sequence(int(run.sum()), len(run))) for run in runs]
        )
    else:
        rate, (low, high) = float(pooled.mean()), wilson(int(pooled.sum()), len(pooled))
    return rate, *out_to_spread(low, high, [float(run.mean()) for run in runs])


def mean_of_strata(strata: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the mean of the strata's means, so that a larger stratum weighs no more; over the last axis."""
    return np.mean([values.mean(axis=-1) for values in strata], axis=0)


def iqm_of_strata(strata: Sequence[np.ndarray]) -> np.ndarray:
    """Returns the interquartile mean of all strata together, over the last axis."""
    from scipy.stats import trim_mean

    return trim_mean(np.concatenate(strata, axis=-1), proportiontocut=0.25, axis=-1)


def stratified_bootstrap(
    strata: Sequence[np.ndarray],
    statistic: Callable[[Sequence[np.ndarray]], np.ndarray] = mean_of_strata,
    *,
    seed: int,
    confidence: float = CONFIDENCE,
    num_resamples: int = 2000,
) -> tuple[float, float]:
    """Returns the percentile interval of a statistic, resampling within each stratum (arXiv:2108.13264 §4.1).

    Args:
        strata: One array per stratum (a level, say) of what is resampled, (n,): outcomes of episodes, or
            scores of training runs.
        statistic: Function of the resampled strata, each (num_resamples, n), to (num_resamples,).
        seed: Seed of the resampling; the same seed gives the same interval.
        confidence: Coverage of the interval.
        num_resamples: Bootstrap samples.

    Raises:
        ValueError: There are no strata, or one is empty.
    """
    if not strata or any(len(values) == 0 for values in strata):
        raise ValueError("A bootstrap needs at least one stratum, and none may be empty.")
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    sizes = [(num_resamples, len(values)) for values in strata]
    resampled = [
        values[rng.integers(len(values), size=size)] for values, size in zip(strata, sizes, strict=True)
    ]
    tail = (1.0 - confidence) / 2.0
    low, high = np.quantile(statistic(resampled), [tail, 1.0 - tail])
    return float(low), float(high)


@cache
def mcnemar(only_a: int, only_b: int) -> float:
    """Returns the exact two-sided p-value of McNemar's test (1947, doi:10.1007/BF02295996).

    Only episodes where one policy succeeds and the other fails count; were the policies
    equal, either would win such an episode with probability one half.

    Args:
        only_a: Episodes where only the first succeeds.
        only_b: Episodes where only the second succeeds.
    """
    from scipy.stats import binomtest

    discordant = only_a + only_b
    return 1.0 if discordant == 0 else float(binomtest(only_a, discordant, 0.5).pvalue)


def paired_difference(
    both: int, only_a: int, only_b: int, neither: int, confidence: float = CONFIDENCE
) -> tuple[float, float, float]:
    """Returns the difference of two success rates on the same episodes, and its interval.

    Method 10 of Newcombe (1998, doi:10.1002/(SICI)1097-0258(19981130)17:22<2635::AID-SIM954>3.0.CO;2-C): it
    adds the squared distances to the ends of both :func:`wilson` intervals, less what the correlation of the
    outcomes explains. It is in closed form, and holds where every episode has the same outcome: a bootstrap
    would call 20 of 20 against 0 of 20 certain.

    Args:
        both: Episodes where both succeed.
        only_a: Episodes where only the first succeeds.
        only_b: Episodes where only the second succeeds.
        neither: Episodes where both fail.
        confidence: Coverage of the interval.

    Returns:
        The rate of the first minus that of the second, lower end, upper end.

    Raises:
        ValueError: There is no episode, or a number is negative.
    """
    n = both + only_a + only_b + neither
    a, b = both + only_a, both + only_b
    (a_low, a_high), (b_low, b_high) = wilson(a, n, confidence), wilson(b, n, confidence)
    rate_a, rate_b = a / n, b / n
    product = float(a) * (n - a) * b * (n - b)
    excess = float(both * neither - only_a * only_b)
    excess = max(excess - n / 2, 0.0) if excess > 0 else excess
    correlation = excess / np.sqrt(product) if product else 0.0

    def reach(first: float, second: float) -> float:
        return float(np.sqrt(max(first**2 - 2 * correlation * first * second + second**2, 0.0)))

    difference = rate_a - rate_b
    low = difference - reach(rate_a - a_low, b_high - rate_b)
    high = difference + reach(rate_b - b_low, a_high - rate_a)
    return difference, low, high


def holm(p_values: Sequence[float]) -> list[float]:
    """Returns p-values that are corrected for their number (Holm 1979, Scand. J. Statist. 6, 65-70).

    Of m true hypotheses, whichever they are, one or more has a corrected p of at most alpha with a
    probability of at most alpha, however the tests depend on each other. The smallest p counts m times, the
    next m - 1 times, and none less than one before it.

    Args:
        p_values: One p-value of each test, in [0, 1].

    Returns:
        The corrected ones, in the order given.

    Raises:
        ValueError: A number is no probability.
    """
    given = np.asarray(p_values, dtype=float)
    if not ((given >= 0.0) & (given <= 1.0)).all():
        raise ValueError(f"A p-value is within 0 to 1, given {list(p_values)}.")
    order = np.argsort(given, kind="stable")
    counted = given[order] * np.arange(len(given), 0, -1)
    corrected = np.empty_like(given)
    corrected[order] = np.minimum(np.maximum.accumulate(counted), 1.0)
    return corrected.tolist()


def e_process(a_wins: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Returns the evidence against "both policies are equally good" after each discordant episode.

    A gambler who starts with 1, bets on every discordant episode by the rate seen so far (a uniform
    prior on it: Laplace's rule) at fair odds holds ``2**n * B(a + 1, b + 1)`` after ``n`` of
    them. If the policies are equal this is a martingale, so it ever reaches ``1 / alpha`` with
    probability at most ``alpha`` (Ville), however often one looks: arXiv:2210.01948 §3, Robbins 1970.

    Args:
        a_wins: For every discordant episode, in order, whether the first policy won it. (n,)

    Returns:
        The capital after each of them, (n,).
    """
    from scipy.special import betaln

    wins = np.cumsum(np.asarray(a_wins, dtype=float))
    n = np.arange(1, len(wins) + 1)
    return np.exp(n * np.log(2.0) + betaln(wins + 1, n - wins + 1))


def compare(a: Sequence[bool], b: Sequence[bool], *, confidence: float = CONFIDENCE) -> PairedTest:
    """Compares two policies on the same episodes, given in the same order.

    Args:
        a: Whether the first policy succeeded, (n,).
        b: Whether the second did, (n,).
        confidence: Coverage of the interval, and one minus the level of the sequential test.

    Raises:
        ValueError: The two differ in length, or are empty.
    """
    first, second = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    if first.shape != second.shape or first.ndim != 1 or len(first) == 0:
        raise ValueError(f"A paired test needs the same episodes twice, given {len(a)} and {len(b)}.")
    discordant = np.flatnonzero(first != second)
    capital = e_process(first[discordant])
    # 1 / (largest capital so far) is a p-value at every time at once.
    crossed = np.flatnonzero(capital >= 1.0 / (1.0 - confidence))
    both, neither = int((first & second).sum()), int((~first & ~second).sum())
    only_a, only_b = int((first & ~second).sum()), int((second & ~first).sum())
    difference, low, high = paired_difference(both, only_a, only_b, neither, confidence)
    return PairedTest(
        num_episodes=len(first),
        both=both,
        only_a=only_a,
        only_b=only_b,
        neither=neither,
        difference=difference,
        ci_low=low,
        ci_high=high,
        p_value=mcnemar(only_a, only_b),
        p_sequential=float(min(1.0, 1.0 / capital.max())) if len(capital) else 1.0,
        decided_after=int(discordant[crossed[0]]) + 1 if len(crossed) else None,
    )
