import itertools
import math

import numpy as np
import pytest

from benchmark import statistics


def test_wilson_by_hand():
    """Wilson 1927 for 8 of 10: (p + z²/2n ± z sqrt(p(1-p)/n + z²/4n²)) / (1 + z²/n)."""
    z, p, n = 1.959963984540054, 0.8, 10
    middle, spread = p + z**2 / (2 * n), z * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low, high = statistics.wilson(8, 10)
    assert low == pytest.approx((middle - spread) / (1 + z**2 / n))
    assert high == pytest.approx((middle + spread) / (1 + z**2 / n))


@pytest.mark.parametrize(("successes", "low", "high"), [(0, 0.0, 0.161), (20, 0.839, 1.0)])
def test_wilson_is_not_certain_at_the_ends(successes, low, high):
    assert statistics.wilson(successes, 20) == pytest.approx((low, high), abs=5e-4)


@pytest.mark.parametrize(("successes", "n"), [(0, 0), (-1, 5), (6, 5)])
def test_wilson_refuses_impossible_counts(successes, n):
    with pytest.raises(ValueError, match=f"given {successes} of {n}"):
        statistics.wilson(successes, n)


def test_confidence_sequence_by_hand():
    """One success of one: p >= B(2, 1) / 20. One of two: p (1 - p) = B(2, 2) / 20 = 1 / 120 at both ends."""
    assert statistics.confidence_sequence(1, 1) == pytest.approx((0.5 * 0.05, 1.0))
    half = math.sqrt(0.25 - 1 / 120)
    assert statistics.confidence_sequence(1, 2) == pytest.approx((0.5 - half, 0.5 + half))
    assert statistics.confidence_sequence(0, 2) == pytest.approx((0.0, 1 - math.sqrt(0.05 / 3)))


def test_confidence_sequence_holds_the_rate_after_every_episode():
    rng, rate, missed = np.random.default_rng(0), 0.7, 0
    for _ in range(400):
        counts = np.cumsum(rng.random(60) < rate)
        bounds = [statistics.confidence_sequence(int(s), n + 1) for n, s in enumerate(counts)]
        missed += any(not low <= rate <= high for low, high in bounds)
    assert 0 < missed / 400 <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 400)


@pytest.mark.parametrize(("successes", "n"), [(0, 30), (7, 10), (95, 100), (1, 9000)])
def test_confidence_sequence_is_wider_than_wilsons_interval(successes, n):
    (low, high), (inner_low, inner_high) = (
        interval(successes, n) for interval in (statistics.confidence_sequence, statistics.wilson)
    )
    assert low <= successes / n <= high and high - low > inner_high - inner_low


def test_narrow_after_is_the_first_episode():
    outcomes = [True] * 200
    n = statistics.narrow_after(outcomes, 0.1)
    assert n is not None
    before, after = (1.0 - statistics.confidence_sequence(count, count)[0] for count in (n - 1, n))
    assert after <= 0.1 < before
    assert statistics.narrow_after(outcomes[: n - 1], 0.1) is None
    assert statistics.narrow_after([True, False] * 100, 0.1) is None, "50 % needs more episodes"


def test_runs_that_stopped_early_weigh_the_same():
    rate, low, high = statistics.rate_of_runs([np.ones(50), np.zeros(10)], stopped_early=True)
    assert (rate, low, high) == (0.5, 0.0, 1.0)
    one = statistics.rate_of_runs([np.array([1.0, 1.0, 0.0])], stopped_early=True)
    assert one[1:] == pytest.approx(statistics.confidence_sequence(2, 3))


def test_iqm_drops_a_quarter_at_either_end():
    assert statistics.iqm(np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 100.0])) == pytest.approx(3.5)
    assert statistics.iqm(np.array([[0.0, 1.0], [2.0, 100.0]])) == pytest.approx(1.5)


def test_mean_of_rates_by_hand():
    """Two cells, 0.5 ± 0.1 and 0.7 ± 0.2: the half widths add as sqrt(0.01 + 0.04) / 2."""
    mean, low, high = statistics.mean_of_rates([(0.5, 0.4, 0.6), (0.7, 0.5, 0.9)])
    assert mean == pytest.approx(0.6)
    assert mean - low == pytest.approx(math.sqrt(0.05) / 2)
    assert high - mean == pytest.approx(math.sqrt(0.05) / 2)


def test_stratified_bootstrap_resamples_within_strata():
    """Constant strata leave nothing to vary; mixing them would."""
    assert statistics.stratified_bootstrap([np.zeros(10), np.ones(10)], seed=0) == (0.5, 0.5)


def test_stratified_bootstrap_covers_about_as_the_normal_interval():
    values = np.random.default_rng(0).normal(2.0, 1.0, size=400)
    low, high = statistics.stratified_bootstrap([values], seed=1)
    half = 1.96 * values.std() / 20
    assert low == pytest.approx(values.mean() - half, abs=0.02)
    assert high == pytest.approx(values.mean() + half, abs=0.02)


def test_bootstrap_follows_its_seed():
    values = [np.random.default_rng(0).random(30)]
    assert statistics.stratified_bootstrap(values, seed=3) == statistics.stratified_bootstrap(values, seed=3)
    assert statistics.stratified_bootstrap(values, seed=3) != statistics.stratified_bootstrap(values, seed=4)


def test_runs_that_differ_widen_the_interval():
    """0 % and 100 % in two runs: 100 pooled episodes would say 40–60 %, the runs say anything."""
    rate, low, high = statistics.rate_of_runs([np.zeros(50), np.ones(50)])
    assert (rate, low, high) == (0.5, 0.0, 1.0)


def test_one_run_has_wilsons_interval():
    assert statistics.rate_of_runs([np.array([1.0, 1.0, 0.0])])[1:] == statistics.wilson(2, 3)


def test_runs_that_always_succeed_are_not_certain():
    _, low, _ = statistics.rate_of_runs([np.ones(10), np.ones(10)])
    assert low == pytest.approx(statistics.wilson(20, 20)[0])


def test_the_mean_of_few_by_hand():
    """0.8, 0.9 and 1: a standard deviation of 0.1, and 4.3027 is the t of two degrees of freedom."""
    half = 4.302653 * 0.1 / math.sqrt(3)
    assert statistics.mean_of_few([0.8, 0.9, 1.0]) == pytest.approx((0.9 - half, 0.9 + half))
    assert statistics.rate_of_runs([np.repeat([1.0, 0.0], [k, 100 - k]) for k in (80, 90, 100)]) == (
        *(pytest.approx(0.9), pytest.approx(0.9 - half), 1.0),
    )


@pytest.mark.parametrize(
    "rates", [[0.2, 0.4], [0.7, 0.75, 0.9], [0.5, 0.5, 0.5, 0.6], list(np.linspace(0, 1, 20))]
)
def test_the_mean_of_few_is_scipys(rates):
    from scipy.stats import sem, t

    theirs = t.interval(0.95, len(rates) - 1, loc=np.mean(rates), scale=sem(rates))
    assert statistics.mean_of_few(rates) == pytest.approx(theirs)


@pytest.mark.parametrize(
    ("rate", "spread", "least"), [(0.75, 0.0, 0.97), (0.75, 0.05, 0.95), (0.75, 0.1, 0.93)]
)
def test_three_seeds_hold_the_true_rate_as_often_as_they_say(rate, spread, least):
    """Of seeds of 100 episodes, whose own rates have a beta distribution around the true one."""
    rng = np.random.default_rng(0)
    sum_of_both = rate * (1 - rate) / spread**2 - 1 if spread else math.inf
    held = 0
    for _ in range(2000):
        own = rng.beta(rate * sum_of_both, (1 - rate) * sum_of_both, 3) if spread else np.full(3, rate)
        runs = [np.repeat([1.0, 0.0], [k, 100 - k]) for k in rng.binomial(100, own)]
        _, low, high = statistics.rate_of_runs(runs)
        held += low <= rate <= high
    assert held / 2000 >= least


def test_mcnemar_by_hand():
    """5 discordant episodes, all won by one: 2 · 2⁻⁵."""
    assert statistics.mcnemar(5, 0) == pytest.approx(2 / 32)
    assert statistics.mcnemar(0, 0) == 1.0
    assert statistics.mcnemar(3, 3) == 1.0


def test_holm_by_hand():
    """0.005 · 4, 0.01 · 3, 0.03 · 2, and 0.04, which is not less than the one before it."""
    assert statistics.holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert statistics.holm([0.5, 0.6]) == [1.0, 1.0]
    assert statistics.holm([0.2]) == [0.2] and statistics.holm([]) == []


def test_holm_is_the_closure_of_bonferronis_test():
    """A reference: the largest of m · min(p) over all sets of m tests that one is in (Marcus et al. 1976)."""
    rng = np.random.default_rng(0)
    for size in (1, 2, 3, 5):
        p = rng.uniform(0.0, 0.4, size) ** 2
        sets = [s for m in range(1, size + 1) for s in itertools.combinations(range(size), m)]
        closed = [max(min(1.0, len(s) * min(p[j] for j in s)) for s in sets if i in s) for i in range(size)]
        assert statistics.holm(p.tolist()) == pytest.approx(closed)


def test_holm_keeps_false_alarms_among_many_tests_rare():
    rng = np.random.default_rng(1)
    alarms = [min(statistics.holm(rng.uniform(size=20).tolist())) <= 0.05 for _ in range(2000)]
    assert np.mean(alarms) <= 0.05 + 3 * math.sqrt(0.05 * 0.95 / 2000)
    assert np.mean(alarms) > 0.03, "and is no more careful than it says"


@pytest.mark.parametrize("p", [-0.1, 1.1, float("nan")])
def test_holm_refuses_what_is_no_probability(p):
    with pytest.raises(ValueError, match="within 0 to 1"):
        statistics.holm([0.5, p])


def test_e_process_by_hand():
    """2ⁿ B(a+1, b+1): after win, win, loss 2·1/2, 4·1/3, 8·1/12."""
    assert statistics.e_process([True, True, False]) == pytest.approx([1.0, 4 / 3, 2 / 3])


def test_e_process_is_a_fair_game():
    """Over all 2ⁿ equally likely histories the mean capital is 1."""
    n = 8
    histories = [[bool(code >> bit & 1) for bit in range(n)] for code in range(2**n)]
    capital = np.stack([statistics.e_process(history) for history in histories])
    assert capital.mean(axis=0) == pytest.approx(np.ones(n))


def test_peeking_does_not_inflate_false_alarms():
    """The exact chance that equal policies ever look different, looked at after each of 200 episodes."""
    alive, alarm = {0: 1.0}, 0.0
    for n in range(1, 201):
        after: dict[int, float] = {}
        for wins, chance in alive.items():
            for now in (wins, wins + 1):
                after[now] = after.get(now, 0.0) + chance / 2
        capital = {wins: 2.0**n / ((n + 1) * math.comb(n, wins)) for wins in after}
        alarm += sum(chance for wins, chance in after.items() if capital[wins] >= 20)
        alive = {wins: chance for wins, chance in after.items() if capital[wins] < 20}
    assert 0.02 < alarm <= 0.05
    history = [True] * 7 + [False] * 2
    assert statistics.e_process(history)[-1] == pytest.approx(2.0**9 / (10 * math.comb(9, 7)))


def test_compare_counts_every_pair():
    a = [True] * 12 + [False, True, False]
    b = [False] * 12 + [False, True, True]
    test = statistics.compare(a, b)
    assert (test.both, test.only_a, test.only_b, test.neither) == (1, 12, 1, 1)
    assert test.difference == pytest.approx(11 / 15)
    assert test.ci_low < test.difference < test.ci_high
    assert test.p_value == pytest.approx(2 * (1 + 13) / 2**13)
    # 2ⁿ / (n + 1) first reaches 20 at n = 8: the test was decided long before all were run.
    assert test.decided_after == 8
    assert test.p_sequential == pytest.approx(13 / 2**12)


def test_compare_of_equal_policies_decides_nothing():
    test = statistics.compare([True, False, True], [True, False, True])
    assert (test.p_value, test.p_sequential, test.decided_after) == (1.0, 1.0, None)


def test_compare_calls_no_difference_certain_where_every_episode_has_the_same_outcome():
    """A bootstrap of 20 equal differences has no width."""
    better, equal = (statistics.compare([True] * 20, [other] * 20) for other in (False, True))
    assert (better.ci_low, better.ci_high) == pytest.approx(statistics.paired_difference(0, 20, 0, 0)[1:])
    assert better.ci_low < 0.9 and better.ci_high == 1.0
    assert equal.ci_low < -0.1 and equal.ci_high > 0.1


def test_compare_needs_the_same_episodes():
    with pytest.raises(ValueError, match="given 2 and 3"):
        statistics.compare([True, False], [True, False, True])


def test_empty_strata_are_refused():
    with pytest.raises(ValueError, match="at least one stratum"):
        statistics.stratified_bootstrap([], seed=0)
    with pytest.raises(ValueError, match="at least two values, given 1"):
        statistics.mean_of_few([0.5])
    with pytest.raises(ValueError, match="at least one cell"):
        statistics.mean_of_rates([])
