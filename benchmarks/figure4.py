"""The paper's Figure 4 made anew, from a finished benchmark, beside the values that it published.

    animarl benchmark --config docs/leaderboard/paper.yml --processes 2 --out out/bench-paper
    python benchmarks/figure4.py --bench out/bench-paper

Violins of the duration of each rollout and of its DTW distance to the recording of its start, by
species and method; and a table of what the paper says in numbers of them: kernel-density distances
to the recordings, and by how much DTW distances lie below those of BC, paired by start. They are of
the test split of the packaged demonstrations, which are synthetic; the paper's are of its own
recordings, so that orders can be compared, and sizes hardly.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd
import typer

from animarl_algos.benchmark.matrix import plan, read_matrix
from animarl_algos.benchmark.pieces import Cell
from animarl_algos.evaluation.comparison import comparison_table, pair_table
from animarl_algos.evaluation.metrics import DTW, DURATION, measure, measure_recordings
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval, interval, percentile_interval
from animarl_algos.report import style
from animarl_algos.report.words import Words, with_interval
from animarl_algos.runs.run_files import versions
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.files import all_files_or_none

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEARNERS = ("dqn", "bc", "dqaas", "dqdil-pt", "dqdil")  # in the order of the paper's columns
BASELINE = "bc"
SHOWN = (DURATION, DTW)  # top and bottom row
SEED = 0  # of all resampling
RESAMPLES = 1000  # of kernel-density distances
POINTS, MARGIN = 512, 4.0  # of a grid of densities, which reaches so many bandwidths further
NARROWEST = 0.01  # no bandwidth is smaller than this share of the pooled range
KDE_PATH, KDE_DURATION = "KDE, path length", "KDE, duration"
LESS_THAN_BC = "DTW of BC less its own"  # above zero: nearer to the recordings than BC
AGENTS_PATH = "1.283 or more, from 1.18 on"
AGENTS_DTW = "0.463 to 0.523, within [-0.089, 1.036]"
FLIES_PATH, FLIES_DTW = "0.258 to 0.413, from 0.162 on", "from 4.929 on"
NEWTS_PATH, NEWTS_DURATION = "0.258 to 0.602", "0.407 to 1.358"
MOTHS_DTW = "interval over zero"
PUBLISHED: dict[tuple[str, str], dict[str, str]] = {
    ("agent", KDE_PATH): {"dqaas": AGENTS_PATH, "dqdil-pt": AGENTS_PATH, "dqdil": AGENTS_PATH},
    ("agent", KDE_DURATION): {
        "dqaas": "0.882 [0.757, 1.008]",
        "dqdil-pt": "1.064 [0.944, 1.183]",
        "dqdil": "0.811 [0.687, 0.935]",
    },
    ("agent", LESS_THAN_BC): {"dqaas": AGENTS_DTW, "dqdil-pt": AGENTS_DTW, "dqdil": AGENTS_DTW},
    ("fly", KDE_PATH): {"dqaas": FLIES_PATH, "dqdil-pt": FLIES_PATH, "dqdil": FLIES_PATH},
    ("fly", KDE_DURATION): {
        "dqaas": "0.528 [0.373, 0.758]",
        "dqdil-pt": "0.714 [0.529, 0.943]",
        "dqdil": "0.837 [0.664, 1.058]",
    },
    ("fly", LESS_THAN_BC): {
        "dqaas": f"9.280, {FLIES_DTW}",
        "dqdil-pt": f"7.970, {FLIES_DTW}",
        "dqdil": f"6.842, {FLIES_DTW}",
    },
    ("newt", KDE_PATH): dict.fromkeys(LEARNERS, NEWTS_PATH),
    ("newt", KDE_DURATION): dict.fromkeys(LEARNERS, NEWTS_DURATION),
    ("silkmoth", KDE_PATH): {
        "dqaas": "[1.464, 1.629]", "dqdil-pt": "[1.372, 1.540]", "dqdil": "[0.947, 1.229]",
    },
    ("silkmoth", KDE_DURATION): {
        "dqaas": "[1.152, 1.342]", "dqdil-pt": "[1.094, 1.291]", "dqdil": "[0.790, 1.036]",
    },
    ("silkmoth", LESS_THAN_BC): {"dqaas": MOTHS_DTW, "dqdil-pt": MOTHS_DTW, "dqdil": MOTHS_DTW},
}  # fmt: skip
"""Section "Reinforcement learning model verification" of the paper; what it gives no number for is
not here. Of newts and of path lengths it gives ranges over the methods alone."""


def measured(cells: Sequence[Cell], bench: Path) -> pd.DataFrame:
    """One row per episode of one species: the recordings first, then every method.

    Raises
    ------
    typer.BadParameter
        If a cell is not finished.
    """
    by_method: dict[str, list[Rollouts]] = {name: [] for name in LEARNERS}
    for cell in cells:
        if not cell.finished(bench):
            raise typer.BadParameter(
                f"{bench}: {cell.name} is not finished: run 'animarl benchmark' with the same "
                "--config first"
            )
        by_method[cell.method].append(cell.rollouts(bench))
    test = load_packaged(cells[0].data).select(split="test")
    joined = [Rollouts.concatenate(some, name) for name, some in by_method.items() if some]
    return pd.concat([measure_recordings(test), *(measure(one, test) for one in joined)])


def kde_distance(simulated: np.ndarray, recorded: np.ndarray) -> float:
    """L1 distance between two Gaussian kernel density estimates, from 0 (equal) to 2 (disjoint).

    The paper's measure. Bandwidths are Scott's, but never less than ``NARROWEST`` of the pooled
    range: where every episode times out, values have no variance. It is biased upwards: two samples
    of 10 and 50 values from one normal distribution differ by about 0.39.
    """
    pooled = np.concatenate([simulated, recorded])
    spread = float(np.ptp(pooled))
    if spread <= 1e-9 * max(1.0, float(np.abs(pooled).max())):
        return 0.0
    sides = (simulated, recorded)
    width = [
        max(NARROWEST * spread, np.std(one, ddof=1) * len(one) ** -0.2 if len(one) > 1 else 0.0)
        for one in sides
    ]
    margin = MARGIN * max(width)
    grid = np.linspace(pooled.min() - margin, pooled.max() + margin, POINTS)
    one, other = (
        np.exp(-0.5 * ((grid - values[:, None]) / w) ** 2).mean(axis=0) / (w * np.sqrt(2 * np.pi))
        for values, w in zip(sides, width)
    )
    return float(np.abs(one - other).sum() * (grid[1] - grid[0]))


def kde_interval(rows: pd.DataFrame, truth: pd.DataFrame, key: str) -> Interval:
    """The distance of a method, with percentiles over resampled seeds and demonstrations."""
    rng, drawn = np.random.default_rng(SEED), []
    seeds, demos = rows["seed"].unique(), truth["demo"].to_numpy()
    known = truth.set_index("demo")[key]
    cells = {cell: one.to_numpy() for cell, one in rows.groupby(["seed", "demo"])[key]}
    nothing = np.zeros(0)
    for _ in range(RESAMPLES):
        chosen = rng.choice(demos, len(demos))
        found = [
            cells.get((seed, demo), nothing)
            for seed in rng.choice(seeds, len(seeds))
            for demo in chosen
        ]
        drawn.append(kde_distance(np.concatenate(found), known[chosen].to_numpy()))
    estimate = kde_distance(rows[key].to_numpy(), known.to_numpy())
    return percentile_interval(estimate, np.array(drawn))


def table_of(data: str, metrics: pd.DataFrame) -> list[dict[str, Any]]:
    """A row per method, with the published values."""
    number = int(metrics["demo"].max()) + 1
    # The protocol of the evaluation, which is what 'animarl evaluate' writes for runs.
    compared = comparison_table(metrics, np.arange(number), np.random.default_rng(SEED))
    pairs = pair_table(metrics, np.arange(number), np.random.default_rng(SEED))
    compared = compared[compared["counting"] == "all"].set_index(["method", "measure"])
    truth = metrics[metrics["method"] == RECORDED]
    pairs = pairs[(pairs["counting"] == "all") & (pairs["measure"] == DTW.key)]
    pairs = pairs[pairs["first"] == BASELINE].set_index("second")
    rows = []
    for name in LEARNERS:
        if name not in metrics["method"].to_numpy():
            continue
        own = metrics[metrics["method"] == name]
        found = {
            KDE_PATH: kde_interval(own, truth, "path_length"),
            KDE_DURATION: kde_interval(own, truth, "duration"),
        }
        if name in pairs.index:
            found[LESS_THAN_BC] = interval(pairs.loc[name])
        row = {"species": data, "method": name}
        row["reached"] = f"{compared.loc[(name, 'reached'), 'value']:.2f}"
        for key in (KDE_PATH, KDE_DURATION, LESS_THAN_BC):
            row[key] = with_interval(found[key]) if key in found else ""
            row[f"{key}: paper"] = PUBLISHED.get((data, key), {}).get(name, "")
        rows.append(row)
    return rows


def draw(by_species: dict[str, pd.DataFrame]) -> Figure:
    """Violins: durations above, DTW distances below, a column for each species."""
    with style.figure_style():
        columns = len(by_species)
        figure, panels = style.new_figure(0.6 + 4.2 * columns, 5.4, len(SHOWN), columns)
        panels = np.reshape(panels, (len(SHOWN), columns))
        for column, (data, metrics) in enumerate(by_species.items()):
            for row, metric in enumerate(SHOWN):
                panel: Axes = panels[row, column]
                first = [RECORDED] if metric.of_recordings else []
                there = metrics["method"].to_numpy()
                names = [name for name in (*first, *LEARNERS) if name in there]
                for place, name in enumerate(names):
                    values = metrics.loc[there == name, metric.key].to_numpy()
                    violin(panel, place, values, style.method_colour(name))
                panel.grid(axis="y", color=style.LINE.hex, linewidth=0.5)
                panel.set_xticks(range(len(names)), [style.method_label(name) for name in names])
                panel.tick_params(axis="x", length=0, rotation=20)
                panel.set_xlim(-0.6, len(names) - 0.4)
                panel.set_ylim(bottom=0)
                panel.set(ylabel=Words().axis(metric), title=data if row == 0 else "")
    return figure


def violin(panel: Axes, place: int, values: np.ndarray, colour: str) -> None:
    """Density of the values, each of them as a dot, and their median."""
    if np.ptp(values) > 0:
        for body in panel.violinplot(values, [place], widths=0.8, showextrema=False)["bodies"]:  # type: ignore[attr-defined]
            body.set(facecolor=colour, edgecolor=colour, alpha=0.35)
    aside = 0.1 * (np.modf(np.arange(len(values)) * 0.6180339887498949)[0] - 0.5)
    panel.plot(
        place + aside, values, ".", color=style.TEXT.hex, markersize=1.4, alpha=0.25,
        markeredgewidth=0, rasterized=True,
    )  # fmt: skip
    panel.plot(place, np.median(values), "o", color=colour, markeredgecolor=style.PAGE.hex)


def markdown(rows: Sequence[dict[str, Any]], seeds: Sequence[int]) -> str:
    """The page."""
    heads = list(rows[0])
    number = ", ".join(f"{name} {one}" for name, one in versions().items())
    lines = [
        "# The paper's Figure 4 made anew",
        "",
        f"    {shlex.join(['python', *sys.argv])}",
        "",
        f"Seeds {', '.join(map(str, seeds))}; {number}.",
        "",
        "![Violins of durations and of DTW distances by method](figure4.png)",
        "",
        "A dot is a rollout from a start of the test split, the ring a median. Below: shares of "
        "episodes that reach the target, kernel-density distances to the recordings (0 to 2), and "
        "by how much summed DTW distances lie below those of BC [arena unit], with 95 % intervals; "
        "behind each what the paper gives in numbers ('from' is the lower end of an interval). Its "
        "recordings are its own, these here synthetic: orders can be compared, sizes hardly.",
        "",
        f"| {' | '.join(heads)} |",
        f"|{'---|' * len(heads)}",
        *(f"| {' | '.join(str(row[head]) for head in heads)} |" for row in rows),
    ]
    return "\n".join(lines) + "\n"


def main(
    bench: Annotated[Path, typer.Option(help="Folder of the finished benchmark.")] = Path(
        "out/bench-paper"
    ),
    config: Annotated[Path, typer.Option(help="What the benchmark was told.")] = Path(
        "docs/leaderboard/paper.yml"
    ),
    species: Annotated[
        list[str] | None, typer.Option(help="Only these of the matrix; repeatable.")
    ] = None,
    out: Annotated[Path, typer.Option(help="The table and the figure.")] = Path(
        "docs/results/figure4"
    ),
) -> None:
    """Draw and tabulate what there is; train nothing."""
    matrix = read_matrix("paper", config)
    if species:
        matrix = matrix.changed(species=tuple(n for n in matrix.species if n in species))
    cells = [cell for cell in plan(matrix).cells if cell.method in LEARNERS]
    by_species = {
        name: measured([cell for cell in cells if cell.data == name], bench)
        for name in matrix.species
    }
    rows = [row for name, metrics in by_species.items() for row in table_of(name, metrics)]
    text = markdown(rows, matrix.seeds)
    with all_files_or_none(out) as part:
        (part / "README.md").write_text(text, encoding="utf-8")
        pd.DataFrame(rows).to_csv(part / "figure4.csv", index=False)
        draw(by_species).savefig(part / "figure4.png", dpi=150)
    print(text)


if __name__ == "__main__":
    typer.run(main)
