"""Statistics: known answers, agreement with SciPy, coverage and uniformity on simulated data."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import stats

from animarl_algos.evaluation.statistics import (
    UNDEFINED,
    Anova,
    Cells,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    draw_weights,
    f_statistic,
    percentile_interval,
    permutation_anova,
    resampled_means,
    within_demo_intervals,
)
from animarl_envs.errors import InputError


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


# -- cells and resampling ------------------------------------------------------------


def test_cells_gather_what_counts() -> None:
    data = cells(
        values=[1.0, 3.0, 10.0, np.nan, 7.0],
        seed=[4, 4, 4, 9, 9],
        demo=[0, 0, 2, 0, 1],
        num_demos=3,
        counts=[True, True, True, True, False],
    )
    assert data.sums.tolist() == [[4.0, 0.0, 10.0], [0.0, 0.0, 0.0]]
    assert data.counts.tolist() == [[2.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    assert data.mean == pytest.approx(14.0 / 3.0)
    assert data.cell_means[0, 0] == 2.0 and np.isnan(data.cell_means[1, 1])


def test_weights_are_a_resample() -> None:
    weights = draw_weights(np.random.default_rng(0), 7, 400)
    assert weights.shape == (400, 7) and (weights.sum(axis=1) == 7).all()
    assert weights.mean() == pytest.approx(1.0)
    with pytest.raises(InputError, match="nothing to resample"):
        draw_weights(np.random.default_rng(0), 0)


def test_resampled_means_equal_the_means_of_the_drawn_rollouts() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(size=(3, 4, 2))
    data = Cells(values.sum(axis=2), np.full((3, 4), 2.0))
    seed_weights, demo_weights = draw_weights(rng, 3, 20), draw_weights(rng, 4, 20)
    fast = resampled_means(data, seed_weights, demo_weights)
    for b in range(20):
        drawn_seeds = np.repeat(np.arange(3), seed_weights[b].astype(int))
        drawn_demos = np.repeat(np.arange(4), demo_weights[b].astype(int))
        assert fast[b] == pytest.approx(values[np.ix_(drawn_seeds, drawn_demos)].mean())


def test_repetitions_are_not_counted_as_independent() -> None:
    """Copying every rollout a hundred times must not shorten the interval."""
    rng = np.random.default_rng(2)
    data = crossed(rng, 4, 20, 1, (0.3, 1.0, 0.2, 0.0))
    copied = Cells(100 * data.sums, 100 * data.counts)
    once = bootstrap_mean(data, np.random.default_rng(5), 500)
    often = bootstrap_mean(copied, np.random.default_rng(5), 500)
    assert (often.low, often.high) == pytest.approx((once.low, once.high))


def test_intervals_of_constants_and_of_nothing() -> None:
    constant = Cells(np.full((2, 5), 3.0), np.ones((2, 5)))
    assert bootstrap_mean(constant, np.random.default_rng(0), 50) == Interval(3.0, 3.0, 3.0)
    empty = bootstrap_mean(Cells(np.zeros((2, 5)), np.zeros((2, 5))), np.random.default_rng(0), 50)
    assert np.isnan([empty.estimate, empty.low, empty.high]).all()


def test_interval_is_undefined_when_many_resamples_are() -> None:
    values = np.where(np.arange(100) < 10, np.nan, 1.0)
    assert np.isnan(percentile_interval(1.0, values).low)
    assert percentile_interval(1.0, np.linspace(0, 1, 1001)).low == pytest.approx(0.025)


def test_interval_holds_the_central_share_of_what_is_defined() -> None:
    values = np.linspace(0, 1, 1001)
    interval = percentile_interval(0.4, values)
    assert (interval.estimate, interval.low, interval.high) == pytest.approx((0.4, 0.025, 0.975))
    half = percentile_interval(0.4, values, confidence=0.5)
    assert (half.low, half.high) == pytest.approx((0.25, 0.75))
    # One in twenty may be without a value, no more.
    for without, defined in ((5, True), (6, False)):
        some = np.where(np.arange(100) < without, np.nan, 1.0)
        assert np.isfinite(percentile_interval(1.0, some).low) == defined
    assert np.isnan(percentile_interval(np.nan, values).low)


def test_intervals_exclude_zero_and_overlap() -> None:
    assert Interval(1.0, 0.1, 2.0).excludes_zero and Interval(-1.0, -2.0, -0.1).excludes_zero
    assert not Interval(1.0, 0.0, 2.0).excludes_zero and not Interval(-1.0, -2.0, 0.0).excludes_zero
    assert not Interval(0.5, -0.5, 0.5).excludes_zero and not UNDEFINED.excludes_zero
    below, above = Interval(0.5, 0.0, 1.0), Interval(2.0, 1.5, 2.5)
    assert not below.overlaps(above) and not above.overlaps(below)
    touching = Interval(1.2, 1.0, 1.5)
    for other in (below, above, touching, UNDEFINED):
        assert touching.overlaps(other) and other.overlaps(touching)
    with pytest.raises(dataclasses.FrozenInstanceError):
        below.low = 2.0  # type: ignore[misc]


def test_misshapen_cells_are_refused() -> None:
    for sums, counts in (((2, 3), (3, 2)), ((3,), (3,)), ((2, 3), (3,)), ((1, 2, 3), (1, 2, 3))):
        with pytest.raises(InputError, match="seeds, demos"):
            Cells(np.zeros(sums), np.zeros(counts))
    with pytest.raises(dataclasses.FrozenInstanceError):
        Cells(np.zeros((1, 1)), np.zeros((1, 1))).sums = np.ones((1, 1))  # type: ignore[misc]


@pytest.mark.parametrize(
    ("seeds", "demos", "sd", "least", "most"),
    [
        # One network, demonstrations vary: the plain bootstrap of a mean.
        (1, 50, (0.0, 1.0, 0.0, 0.5), 0.90, 0.98),
        # Five seeds that differ little beside the demonstrations, the usual case.
        (5, 50, (0.1, 1.0, 0.3, 1.0), 0.90, 0.99),
        # Many seeds and demonstrations, both vary.
        (20, 30, (1.0, 1.0, 0.3, 1.0), 0.90, 0.98),
        # Five seeds that differ most: known to be too short (about 0.85), as documented.
        (5, 50, (1.0, 0.3, 0.3, 1.0), 0.78, 0.92),
    ],
)
def test_coverage_of_the_hierarchical_interval(
    seeds: int, demos: int, sd: tuple[float, ...], least: float, most: float
) -> None:
    rng = np.random.default_rng(3)
    hits = []
    for _ in range(300):
        interval = bootstrap_mean(crossed(rng, seeds, demos, 3, sd), rng, 400)
        hits.append(interval.low <= 0.0 <= interval.high)
    assert least <= np.mean(hits) <= most


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
    with pytest.raises(InputError, match="same demonstrations"):
        bootstrap_difference(first, Cells(np.ones((1, 3)), np.ones((1, 3))), rng)


def test_shared_seeds_are_resampled_together() -> None:
    """One network asked two questions: what the seed adds to both cancels."""
    rng = np.random.default_rng(5)
    network = rng.normal(0, 10, (5, 1)) + np.zeros((5, 30))
    first, second = Cells(network + 1.0, np.ones((5, 30))), Cells(network, np.ones((5, 30)))
    shared = bootstrap_difference(first, second, rng, 500, same_seeds=True)
    apart = bootstrap_difference(first, second, rng, 500)
    assert (shared.low, shared.high) == pytest.approx((1.0, 1.0))
    assert apart.high - apart.low > 5.0


def test_within_demo_intervals_take_out_what_demonstrations_share() -> None:
    """Far apart from the same starts, though each mean by itself is vague."""
    rng = np.random.default_rng(3)
    shared = rng.normal(0, 60.0, 50)
    values = np.stack(
        [shared + rng.normal(0, 2.0, 50) + centre for centre in (100.0, 110.0, 120.0)]
    )
    demos = draw_weights(rng, 50, 2000)
    resampled = values @ demos.T / 50
    own = [percentile_interval(v.mean(), r) for v, r in zip(values, resampled)]
    within = within_demo_intervals(values.mean(axis=1), resampled)
    assert own[0].overlaps(own[2])
    assert not within[0].overlaps(within[1]) and not within[1].overlaps(within[2])
    assert [w.estimate for w in within] == pytest.approx(values.mean(axis=1))


def test_within_demo_intervals_equal_the_means_own_without_shared_spread() -> None:
    """With independent methods nothing is shared, and the scaled interval keeps its width."""
    rng = np.random.default_rng(4)
    widths, own_widths = [], []
    for _ in range(60):
        values = rng.normal(0, 1.0, (4, 40))
        resampled = values @ draw_weights(rng, 40, 800).T / 40
        widths += [i.high - i.low for i in within_demo_intervals(values.mean(axis=1), resampled)]
        own_widths += [
            i.high - i.low
            for i in (percentile_interval(v.mean(), r) for v, r in zip(values, resampled))
        ]
    assert np.mean(widths) == pytest.approx(np.mean(own_widths), rel=0.03)


def test_within_demo_intervals_need_two_methods() -> None:
    alone = within_demo_intervals([1.0], np.zeros((1, 10)))
    assert alone[0].estimate == 1.0 and np.isnan(alone[0].low)
    with pytest.raises(InputError, match="methods, resamples"):
        within_demo_intervals([1.0, 2.0], np.zeros((3, 10)))
    for estimates, resampled in ((np.zeros((2, 1)), np.zeros((2, 10))), ([1.0, 2.0], [1.0, 2.0])):
        with pytest.raises(InputError, match="methods, resamples"):
            within_demo_intervals(estimates, resampled)


def test_within_demo_intervals_by_hand() -> None:
    """Two methods, scaled by sqrt(2 / 1) about their own means."""
    draws = np.array([[1.0, 2.0, 3.0], [5.0, 4.0, 9.0]])
    first, second = within_demo_intervals([2.0, 6.0], draws, confidence=1.0)
    # Less each resample's mean (3, 3, 6): -2, -1, -3 and 2, 1, 3; less -2 and 2; times sqrt(2).
    root = 2.0**0.5
    assert (first.estimate, first.low, first.high) == pytest.approx((2.0, 2.0 - root, 2.0 + root))
    assert (second.estimate, second.low, second.high) == pytest.approx((6.0, 6 - root, 6 + root))


def test_same_generator_same_numbers() -> None:
    data = crossed(np.random.default_rng(6), 3, 10, 2, (1.0, 1.0, 1.0, 1.0))
    intervals = [bootstrap_mean(data, np.random.default_rng(9), 200) for _ in range(2)]
    assert intervals[0] == intervals[1]


# -- ANOVA ------------------------------------------------------------


def test_f_equals_scipy() -> None:
    groups = np.random.default_rng(7).normal(size=(4, 9)) + np.arange(4)[:, None]
    assert f_statistic(groups) == pytest.approx(stats.f_oneway(*groups).statistic)


def test_f_of_many_tables_is_the_f_of_each() -> None:
    tables = np.random.default_rng(10).normal(size=(5, 2, 3, 4))
    each = [[stats.f_oneway(*table).statistic for table in row] for row in tables]
    np.testing.assert_allclose(f_statistic(tables), each)


def test_permutation_p_counts_the_observed_order_too() -> None:
    """Known answers: two pairs far apart, which 2 of 4 orders within pairs keep so."""
    table = np.array([[0.0, 0.1], [100.0, 100.2]])
    rng = np.random.default_rng(11)
    result = permutation_anova(table, rng, 4000, paired=True, unit="demonstration")
    assert result.f == pytest.approx(stats.f_oneway(*table).statistic)
    assert result.unit == "demonstration"
    assert result.p == pytest.approx(1 / 2, abs=0.03)
    # Dealt afresh, 8 of the 24 orders keep the pairs together: the two below, and the two above.
    assert permutation_anova(table, rng, 4000, paired=False).p == pytest.approx(1 / 3, abs=0.03)
    far = np.arange(40.0).reshape(2, 20)
    assert permutation_anova(far, rng, 9, paired=False) == Anova(
        float(f_statistic(far)), 1 / 10, "unit"
    )


def test_an_anova_of_a_large_table_is_done_in_parts() -> None:
    """More numbers than are permuted at once; nothing differs, so p is anything but small."""
    table = np.random.default_rng(12).normal(size=(2, 400_000))
    result = permutation_anova(table, np.random.default_rng(13), 5, paired=True)
    assert (result.p * 6) == pytest.approx(round(result.p * 6)) and 1 / 6 <= result.p <= 1.0


def test_anova_of_equal_values_finds_nothing() -> None:
    assert permutation_anova(np.ones((2, 2)), np.random.default_rng(0), paired=True) == Anova(
        0.0, 1.0, "unit"
    )


@pytest.mark.parametrize("paired", [True, False])
def test_permutation_p_is_uniform_when_nothing_differs(paired: bool) -> None:
    rng = np.random.default_rng(8)
    shared = rng.normal(0, 3, (400, 1, 12)) if paired else np.zeros((400, 1, 1))
    tables = shared + rng.exponential(size=(400, 3, 12))
    p = [permutation_anova(t, rng, 199, paired=paired).p for t in tables]
    assert stats.kstest(p, "uniform").pvalue > 0.01
    assert np.mean(np.array(p) <= 0.05) <= 0.09


def test_permutation_anova_sees_a_difference_that_pairing_uncovers() -> None:
    rng = np.random.default_rng(9)
    table = rng.normal(0, 5, (1, 30)) + rng.normal(0, 0.3, (3, 30)) + [[0.0], [0.0], [1.0]]
    assert permutation_anova(table, rng, 999, paired=True).p < 0.01
    assert permutation_anova(table, rng, 999, paired=False).p > 0.2


def test_anova_refuses_what_it_cannot_judge() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="two groups"):
        permutation_anova(np.ones((1, 5)), rng, paired=True)
    with pytest.raises(InputError, match="two groups"):
        permutation_anova(np.ones((5, 1)), rng, paired=True)
    with pytest.raises(InputError, match="two groups"):
        permutation_anova(np.ones((2, 2, 2)), rng, paired=True)
    with pytest.raises(InputError, match="finite"):
        permutation_anova([[1.0, np.nan], [1.0, 2.0]], rng, paired=True)
    assert permutation_anova(np.ones((2, 5)), rng, paired=True).p == 1.0
