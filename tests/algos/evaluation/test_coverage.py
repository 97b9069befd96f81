"""Coverage of nominal 95 % intervals, and false alarms, on simulated experiments (small versions).

``benchmarks/stated_coverage.py`` has the whole grid.
"""

import numpy as np
import pytest

from animarl_algos.evaluation.statistics import Cells, Draws, bootstrap_difference, bootstrap_mean
from benchmarks import stated_coverage

EXPERIMENTS = 500
TINY = {
    "SEEDS": (1, 3), "DEMOS": (10,), "RESAMPLES": 50, "STARTS": (10,), "SETS": ("fly",),
    "EPISODES": 10, "GATES": ((3, 3),), "OTHER_SEEDS": (1, 3), "SHARES": (0.5,),
}  # fmt: skip
CHANCE = 0.035  # three and a half standard errors of a share of 0.95 in 500 experiments


def experiment(
    rng: np.random.Generator, seeds: int, demo: np.ndarray, *, log: bool = False, network: float
) -> Cells:
    """One method: three rollouts from each demonstration, seeds that differ by ``network``."""
    size = (seeds, len(demo))
    mean = demo + network * rng.normal(size=(seeds, 1)) + 0.3 * rng.normal(size=size)
    values = mean[..., None] + 0.5 * rng.normal(size=(*size, 3))
    return Cells((np.exp(values) if log else values).sum(axis=2), np.full(size, 3.0))


@pytest.mark.parametrize("seeds", [3, 5])
@pytest.mark.parametrize("network", [0.3, 1.0])
@pytest.mark.parametrize("demos", [10, 50])
def test_coverage_of_means_where_seeds_vary(seeds: int, network: float, demos: int) -> None:
    rng, draws = np.random.default_rng([seeds, demos]), Draws(1, 400)
    inside = 0
    for _ in range(EXPERIMENTS):
        found = bootstrap_mean(
            experiment(rng, seeds, rng.normal(size=demos), network=network), draws
        )
        inside += found.low <= 0.0 <= found.high
    assert 0.93 - CHANCE <= inside / EXPERIMENTS <= 0.97 + CHANCE / 2


@pytest.mark.parametrize("demos", [10, 50])
def test_coverage_of_skewed_means_of_one_network(demos: int) -> None:
    """The studentised bootstrap follows the long tail, which Student's t does not."""
    rng, draws = np.random.default_rng(demos), Draws(1, 400)
    truth = np.exp(0.5 * (0.7**2 + 0.3**2 + 0.5**2))
    inside = 0
    for _ in range(EXPERIMENTS):
        demo = 0.7 * rng.normal(size=demos)
        found = bootstrap_mean(experiment(rng, 1, demo, log=True, network=0.0), draws)
        inside += found.low <= truth <= found.high
    assert inside / EXPERIMENTS >= 0.90 - CHANCE / 2


def test_coverage_of_paired_differences_and_of_cue_shifts() -> None:
    rng, draws = np.random.default_rng(2), Draws(1, 400)
    paired = shifts = 0
    widths = []
    for _ in range(EXPERIMENTS):
        demo = rng.normal(0, 5.0, 20)
        first = experiment(rng, 3, demo + 1.0, network=0.5)
        second = experiment(rng, 5, demo, network=0.5)
        gap = bootstrap_difference(first, second, draws)
        paired += gap.low <= 1.0 <= gap.high
        widths.append(gap.high - gap.low)
        network, told = rng.normal(0, 5.0, (3, 1)), 1.0 + rng.normal(0, 0.5, (3, 1))
        asked = [
            experiment(rng, 3, demo, network=0.0).sums / 3 + network + cue for cue in (0.0, told)
        ]
        shift = bootstrap_mean(Cells(asked[1] - asked[0], np.ones((3, 20))), draws)
        shifts += shift.low <= 1.0 <= shift.high
    assert np.mean(widths) < 3.0  # what demonstrations share, 6.6 wide, is out of it
    for inside in (paired, shifts):
        assert 0.93 - CHANCE <= inside / EXPERIMENTS <= 0.97 + CHANCE / 2


@pytest.mark.parametrize("section", list(stated_coverage.SECTIONS))
def test_every_section_of_the_benchmark_runs_to_its_end(
    section: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, value in TINY.items():
        monkeypatch.setattr(stated_coverage, name, value)
    arguments = ["stated_coverage.py", "--experiments", "1", "--only", section]
    monkeypatch.setattr("sys.argv", arguments)
    stated_coverage.main()
    assert "|---|" in capsys.readouterr().out
