"""Statistics and energy scores: known answers, agreement with SciPy, coverage on simulated data."""

import math

import numpy as np
import pytest
from scipy import stats

from animarl_algos.evaluation.comparison import gate
from animarl_algos.evaluation.statistics import (
    UNDEFINED,
    Cells,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    demo_margins,
    energy_cells,
    energy_score,
    energy_scores,
    mean_over_seeds,
    percentile_interval,
    pooled_score,
    share_margins,
)


def crossed(
    rng: np.random.Generator, seeds: int, demos: int, repetitions: int, sd: tuple[float, ...]
) -> Cells:
    """Cells of a crossed design with true mean 0; ``sd`` of seeds, demos, cells, repetitions."""
    means = (
        rng.normal(0, sd[0], (seeds, 1))
        + rng.normal(0, sd[1], (1, demos))
        + rng.normal(0, sd[2], (seeds, demos))
    )
    values = means[..., None] + rng.normal(0, sd[3], (seeds, demos, repetitions))
    return Cells(values.sum(axis=2), np.full((seeds, demos), float(repetitions)))


def test_weights_are_a_resample() -> None:
    weights = Draws(0, 400).of(7)
    assert weights.shape == (400, 7) and (weights.sum(axis=1) == 7).all()
    assert weights.mean() == pytest.approx(1.0)


def test_cells_gather_what_counts() -> None:
    data = cells(
        values=[1.0, 3.0, 10.0, np.nan, 7.0], seed=[4, 4, 4, 9, 9], demo=[0, 0, 2, 0, 1],
        num_demos=3, counts=[True, True, True, True, False],
    )  # fmt: skip
    assert data.sums.tolist() == [[4.0, 0.0, 10.0], [0.0, 0.0, 0.0]]
    assert data.counts.tolist() == [[2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    assert data.mean == pytest.approx(14.0 / 3.0)
    assert data.cell_means[0, 0] == 2.0 and np.isnan(data.cell_means[1, 1])


def test_a_cell_in_which_nothing_counts_adds_nothing() -> None:
    data = cells([1.0, 3.0, 10.0, 4.0], [4, 4, 4, 9], [0, 0, 2, 1], num_demos=4)
    assert data.deviations.mean() == pytest.approx(0.0)
    assert (data.deviations == 0).tolist() == (data.counts == 0).tolist()
    complete = crossed(np.random.default_rng(0), 3, 5, 2, (1.0, 1.0, 1.0, 1.0))
    assert complete.deviations == pytest.approx(complete.cell_means - complete.mean)
    even = data.even
    assert even.counts.sum(axis=0).tolist() == [1.0, 1.0, 1.0, 0.0]
    assert even.mean == pytest.approx((2.0 + 4.0 + 10.0) / 3)


def test_repetitions_are_not_counted_as_independent() -> None:
    """Copying every rollout a hundred times must not shorten the interval."""
    rng = np.random.default_rng(2)
    data = crossed(rng, 4, 20, 1, (0.3, 1.0, 0.2, 0.0))
    copied = Cells(100 * data.sums, 100 * data.counts)
    once = bootstrap_mean(data, np.random.default_rng(5), 500)
    often = bootstrap_mean(copied, np.random.default_rng(5), 500)
    assert (often.low, often.high) == pytest.approx((once.low, once.high))


def test_intervals_of_constants_of_one_and_of_nothing() -> None:
    rng = np.random.default_rng(0)
    constant = Cells(np.full((2, 5), 3.0), np.ones((2, 5)))
    assert bootstrap_mean(constant, rng, 50) == Interval(3.0, 3.0, 3.0)
    empty = bootstrap_mean(Cells(np.zeros((2, 5)), np.zeros((2, 5))), rng, 50)
    assert np.isnan([empty.estimate, empty.low, empty.high]).all()
    assert empty.reason == "no episode counts"
    one = bootstrap_mean(Cells(np.full((3, 1), 2.0), np.ones((3, 1))), rng, 50)
    assert one.estimate == 2.0 and np.isnan([one.low, one.high]).all()
    assert one.reason.startswith("one demonstration")


@pytest.mark.parametrize("demos", [3, 7])
def test_few_demonstrations_of_one_network_get_students_t(demos: int) -> None:
    values = np.random.default_rng(1).normal(size=demos)
    found = bootstrap_mean(Cells(values[None], np.ones((1, demos))), np.random.default_rng(2), 50)
    expected = stats.t.interval(0.95, demos - 1, values.mean(), stats.sem(values))
    assert (found.low, found.high) == pytest.approx(expected)


def test_a_studentised_bootstrap_by_hand() -> None:
    """Each resample's deviation over its own standard error; the tails change sides."""
    values, draws = np.random.default_rng(3).lognormal(size=60), Draws(4, 400)
    t = []
    for weights in draws.of(60):
        drawn = np.repeat(values, weights.astype(int))
        t.append((drawn.mean() - values.mean()) / (drawn.std() / np.sqrt(59)))
    low, high = np.percentile(t, [2.5, 97.5])
    below, above = demo_margins(values, draws)
    error = stats.sem(values)
    assert (below, above) == pytest.approx((high * error, -low * error))
    assert above > below  # the long tail of skewed values lies above


@pytest.mark.parametrize("number", [8, 50])
def test_a_margin_of_few_demonstrations_is_at_least_students_t(number: int) -> None:
    values = np.random.default_rng(number).lognormal(size=number)
    half = stats.t.ppf(0.975, number - 1) * stats.sem(values)
    assert min(demo_margins(values, Draws(4, 400))) >= half * (1 - 1e-12)


def test_an_interval_of_values_nearly_all_alike_ends_near_them() -> None:
    """Without a longest length the upper end is at some thousands."""
    values = np.concatenate([np.full(9, 1.0) + 1e-4 * np.arange(9), [2.3]])
    below, above = demo_margins(values, Draws(4, 2000))
    half = stats.t.ppf(0.975, 9) * stats.sem(values)
    assert below == pytest.approx(half) and half < above <= 2 * (2.3 - values.mean()) + 1e-12


@pytest.mark.parametrize(("number", "least"), [(10, 0.82), (50, 0.93)])
def test_coverage_where_four_in_five_values_are_alike(number: int, least: float) -> None:
    rng, draws = np.random.default_rng(number), Draws(1, 400)
    size = (1000, number)
    rest, moving = 1e-3 * rng.normal(size=size), rng.exponential(size=size)
    values = np.where(rng.random(size) < 0.8, rest, moving)
    below, above = demo_margins(values, draws)
    miss = 0.2 - values.mean(axis=1)
    assert np.mean((-below <= miss) & (miss <= above)) >= least


def test_the_difference_of_two_shares_is_newcombes() -> None:
    """Method 10 of Newcombe (1998): no width of zero, and nothing beyond 100 points."""
    every, none = (
        Cells(np.ones((1, 12)), np.ones((1, 12))),
        Cells(np.zeros((1, 12)), np.ones((1, 12))),
    )
    rng = np.random.default_rng(0)
    same = bootstrap_difference(every, every, rng, share=True)
    assert same.estimate == 0.0 and same.low < 0.0 < same.high
    gap = bootstrap_difference(every, none, rng, share=True)
    ends = [bootstrap_mean(data, rng, share=True) for data in (every, none)]
    assert gap.high == 1.0
    assert gap.low == pytest.approx(1.0 - np.hypot(1.0 - ends[0].low, ends[1].high))


def test_seeds_alone_get_students_t_of_their_means() -> None:
    """Where demonstrations are all alike, networks are all that varies."""
    level = np.random.default_rng(5).normal(size=4)
    data = Cells(level[:, None] + np.zeros((4, 30)), np.ones((4, 30)))
    found = bootstrap_mean(data, np.random.default_rng(6), 100)
    expected = stats.t.interval(0.95, 3, level.mean(), stats.sem(level))
    assert (found.low, found.high) == pytest.approx(expected)
    alone, one = mean_over_seeds(level), mean_over_seeds(level[:1])
    assert (alone.low, alone.high) == pytest.approx(expected)
    assert one.estimate == level[0] and math.isnan(one.low) and "one training seed" in one.reason


def test_a_share_stays_between_none_and_all() -> None:
    rng = np.random.default_rng(7)
    none = bootstrap_mean(Cells(np.zeros((1, 20)), np.full((1, 20), 5.0)), rng, share=True)
    assert none.low == 0.0 and 0.1 < none.high < 0.25
    few = bootstrap_mean(Cells(np.eye(1, 20) * 5, np.full((1, 20), 5.0)), rng, share=True)
    assert 0.0 < few.low < 0.05 < few.high < 0.3
    # Of many independent episodes it is Wilson's.
    values = (np.arange(2000) < 300).astype(float)
    below, above = share_margins(0.15, values)
    wilson = stats.binomtest(300, 2000).proportion_ci(method="wilson")
    assert (0.15 - below, 0.15 + above) == pytest.approx((wilson.low, wilson.high), abs=1e-4)


def test_interval_holds_the_central_share_of_what_is_defined() -> None:
    values = np.linspace(0, 1, 1001)
    interval = percentile_interval(0.4, values)
    assert (interval.estimate, interval.low, interval.high) == pytest.approx((0.4, 0.025, 0.975))
    # One in twenty may be without a value, no more.
    for without, defined in ((5, True), (6, False)):
        some = np.where(np.arange(100) < without, np.nan, 1.0)
        assert np.isfinite(percentile_interval(1.0, some).low) == defined
    assert np.isnan(percentile_interval(np.nan, values).low)


def test_intervals_exclude_zero() -> None:
    assert Interval(1.0, 0.1, 2.0).excludes_zero and Interval(-1.0, -2.0, -0.1).excludes_zero
    assert not Interval(1.0, 0.0, 2.0).excludes_zero and not Interval(-1.0, -2.0, 0.0).excludes_zero
    assert not Interval(0.5, -0.5, 0.5).excludes_zero and not UNDEFINED.excludes_zero


def test_pairing_removes_what_demonstrations_share() -> None:
    rng = np.random.default_rng(4)
    level = rng.normal(0, 10, (1, 40))
    first = Cells(level + 0.5 + rng.normal(0, 0.1, (3, 40)), np.ones((3, 40)))
    second = Cells(level + rng.normal(0, 0.1, (1, 40)), np.ones((1, 40)))
    interval = bootstrap_difference(first, second, rng, 1000)
    assert interval.estimate == pytest.approx(first.mean - second.mean)
    assert interval.low < 0.5 < interval.high
    assert interval.high - interval.low < 0.2
    assert interval.excludes_zero
    sides = [Cells(level * chosen, 1.0 * chosen) for chosen in np.eye(2, 40)[:, None]]
    assert bootstrap_difference(*sides, rng, 50).reason == "no shared start"


def test_known_answers_of_the_gate() -> None:
    """Of 6 ways to deal two pairs far apart, 2 keep them together."""
    rng = np.random.default_rng(11)
    result = gate([np.array([0.0, 0.1]), np.array([100.0, 100.2])], rng)
    assert result.least == pytest.approx(2 / 6) and result.p == pytest.approx(2 / 6, abs=0.02)
    assert result.decision == "cannot be decided with so few seeds"
    unequal = gate([np.array([5.0]), np.array([0.0, 0.1, 0.2])], rng)
    assert unequal.p == pytest.approx(1 / 4, abs=0.02)
    drawn = gate([np.arange(20.0), np.arange(20.0) + 100], rng, 99)
    assert drawn.p == 1 / 100 and drawn.decision == "passed"
    assert gate([np.ones(4), np.ones(4)], rng).p == 1.0


@pytest.mark.parametrize(
    ("sizes", "decides"),
    [((3, 3), False), ((2, 2, 2), False), ((1, 1, 1), False), ((3, 3, 3), True), ((4, 4), True)],
)
def test_so_few_seeds_decide_nothing(sizes: tuple[int, ...], decides: bool) -> None:
    """Whatever the values: the best of all arrangements is not rare enough."""
    apart = [100.0 * k + np.arange(float(n)) for k, n in enumerate(sizes)]
    result = gate(apart, np.random.default_rng(0))
    assert (result.decision == "passed") == decides
    assert not decides or result.p == pytest.approx(result.least, abs=0.003)


@pytest.mark.parametrize("sizes", [(3, 3, 3), (2, 5, 4)])
def test_the_gate_passes_in_one_of_twenty_where_nothing_differs(sizes: tuple[int, ...]) -> None:
    rng = np.random.default_rng(8)
    p = [gate([rng.exponential(size=n) for n in sizes], rng, 199).p for _ in range(400)]
    assert np.mean(np.array(p) <= 0.05) <= 0.08


def test_a_score_worked_out_by_hand() -> None:
    # mean error (1 + 3 + 0) / 3; pairs |1-(-3)|, |1-0|, |-3-0| once each: 8 / (3 * 2)
    assert energy_score([1.0, -3.0, 0.0], 0.0) == pytest.approx(4 / 3 - 8 / 6)
    assert energy_score([[3.0, 4.0], [0.0, 0.0]], [0.0, 0.0]) == pytest.approx(2.5 - 2.5)


def test_cells_hold_the_score_of_each_seed_and_start() -> None:
    rng = np.random.default_rng(4)
    values, recorded = rng.normal(size=60), np.array([0.5, np.nan, -1.0, 2.0])
    values[3] = np.nan
    seed, demo = rng.integers(5, 7, 60), rng.integers(0, 4, 60)
    found = energy_cells(values, seed, demo, recorded)
    assert found.counts[:, 1].tolist() == [0.0, 0.0]
    for row, one in enumerate((5, 6)):
        for start in (0, 2, 3):
            chosen = (seed == one) & (demo == start) & np.isfinite(values)
            expected = energy_score(values[chosen], recorded[start])
            assert found.sums[row, start] == pytest.approx(expected)
    assert energy_cells([1.0, 2.0], [0, 1], [0, 0], [1.0]).counts.sum() == 0


def test_one_rollout_shows_no_spread() -> None:
    assert math.isnan(energy_score([1.0], 0.0))
    scores = energy_scores([1.0, 2.0, 5.0], [0, 0, 1], [1.0, 5.0])
    assert scores[0] == pytest.approx(0.0)
    assert math.isnan(scores[1])


def test_to_know_the_start_is_worth_something() -> None:
    rng = np.random.default_rng(2)
    recorded = rng.normal(0.0, 3.0, 200)
    demo = np.repeat(np.arange(200), 2)
    knowing = energy_scores(recorded[demo] + rng.normal(size=400), demo, recorded).mean()
    assert knowing < 0.6 * pooled_score(recorded)
    assert pooled_score(recorded) == pytest.approx(3.0 / math.sqrt(math.pi), rel=0.15)
