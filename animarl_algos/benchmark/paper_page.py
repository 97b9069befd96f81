"""The page of the paper made anew: tables, figures and sentences from records alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from animarl_algos.benchmark.paper import (
    ADAPTED,
    COUNTERFACTUAL,
    JOINT,
    LEARNERS,
    ONSET,
    PAPER_STEPS,
    PaperCell,
    Record,
    Scope,
    count_speeds,
    example_starts,
    speed_edges,
)
from animarl_algos.evaluation.metrics import (
    DTW,
    DURATION,
    PATH_LENGTH,
    TARGET_REACHED,
    measure,
    measure_recordings,
)
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.statistics import (
    Cells,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    percentile_interval,
    row_of,
)
from animarl_algos.evaluation.teams import roll_out_teams, teams_of
from animarl_algos.report import style
from animarl_algos.report.figures import REFERENCE, draw_paths, view_of
from animarl_algos.report.words import number, with_interval
from animarl_algos.whatif.truth import subtract
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing import markdown_table
from animarl_envs.files import all_files_or_none
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.species import get_species

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

HERE = Path(__file__).parent
RESULTS = Path("results") / "paper"
EARLIER = "earlier.csv"
RECORDED, TRUTH, SIMULATED = "recorded", "truth", "dqdil-pt"
PLURALS = {"agent": "agents", "fly": "flies", "newt": "newts", "silkmoth": "silkmoths"}
PRETRAINED = {"agent": True, "silkmoth": False}  # of Figure 5; Text S1 has the others
SEED, RESAMPLES = 0, 1000
DENSITY_POINTS, DENSITY_MARGIN = 512, 4.0  # of a grid, which reaches so many bandwidths further
NARROWEST = 0.01  # no bandwidth is smaller than this share of the pooled range
MOST_DOTS = 150
PATH_POINTS = 150
"""Points of a drawn path, at most."""


def published(part: str) -> dict[tuple[str, str, str], str]:
    """Return what the paper gives, or a cell costs, by species, row and measure."""
    table = pd.read_csv(HERE / "published.csv", dtype=str)
    rows = table[table["part"] == part].drop(columns="part").itertuples(index=False)
    return {(species, row, measure): value for species, row, measure, value in rows}


# -- kernel-density distances ----------------------------------------------------------------------


def densities(samples: Sequence[Floats]) -> tuple[list[Floats], float]:
    """Return each value's Gaussian on a shared grid, ``(values, points)``, and the grid's step.

    Bandwidths are Scott's, but never less than :data:`NARROWEST` of the pooled range: where every
    episode times out, values have no variance.
    """
    pooled = np.concatenate(samples)
    spread = float(np.ptp(pooled)) or 1.0
    widths = [
        max(NARROWEST * spread, np.std(one, ddof=1) * len(one) ** -0.2 if len(one) > 1 else 0.0)
        for one in samples
    ]
    margin = DENSITY_MARGIN * max(widths)
    grid = np.linspace(pooled.min() - margin, pooled.max() + margin, DENSITY_POINTS)
    bumps = [
        np.exp(-0.5 * ((grid - one[:, None]) / width) ** 2) / (width * np.sqrt(2 * np.pi))
        for one, width in zip(samples, widths)
    ]
    return bumps, float(grid[1] - grid[0])


def kde_distance(simulated: Floats, recorded: Floats) -> float:
    """L1 distance between two Gaussian kernel density estimates, from 0 (equal) to 2 (disjoint).

    The paper's measure. It is biased upwards: two samples of 10 and 50 values from one normal
    distribution differ by about 0.39.
    """
    (one, other), step = densities([simulated, recorded])
    return float(np.abs(one.mean(axis=0) - other.mean(axis=0)).sum() * step)


def kde_interval(rows: pd.DataFrame, truth: pd.DataFrame, key: str) -> Interval:
    """Return a method's distance, with percentiles over resampled seeds and demonstrations.

    Bandwidths stay those of the whole samples.
    """
    rng = np.random.default_rng(SEED)
    known = truth.sort_values("demo")[key].to_numpy(np.float64)
    (one, other), step = densities([rows[key].to_numpy(np.float64), known])
    seeds, seed = np.unique(rows["seed"], return_inverse=True)
    of_demos = rng.multinomial(len(known), np.full(len(known), 1 / len(known)), RESAMPLES)
    of_seeds = rng.multinomial(len(seeds), np.full(len(seeds), 1 / len(seeds)), RESAMPLES)
    weights = of_seeds[:, seed] * of_demos[:, rows["demo"].to_numpy()]
    with np.errstate(invalid="ignore"):
        simulated = weights @ one / weights.sum(axis=1, keepdims=True)
    drawn = np.abs(simulated - of_demos @ other / len(known)).sum(axis=1) * step
    estimate = float(np.abs(one.mean(axis=0) - other.mean(axis=0)).sum() * step)
    return percentile_interval(estimate, drawn)


# -- what was found --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Findings:
    """Records of a scope, and the tables that come from them.

    ``kept`` is a folder of committed records, whose ``earlier.csv`` has rows of Figure 4 that were
    made before records were kept.
    """

    scope: Scope
    records: Sequence[tuple[PaperCell, Record | None, bool]]
    kept: Path | None = None

    def of(self, species: str, setting: str, learner: str) -> list[Record]:
        """Return the records of all seeds."""
        return [
            record
            for one, record, _ in self.records
            if record is not None
            and (one.cell.data, one.setting, one.cell.method) == (species, setting, learner)
        ]

    def rows(self, species: str, setting: str, learner: str, flipped: bool = False) -> pd.DataFrame:
        """Return one row per rollout of all seeds, under the cue given or the other one."""
        parts = [
            record.episodes.assign(seed=record.about["seed"])
            for record in self.of(species, setting, learner)
        ]
        if not parts:
            return pd.DataFrame()
        whole = pd.concat(parts, ignore_index=True)
        given = (whole["cue"] == NO_CUE) | (whole["cue"] == whole["condition"])
        return whole[given != flipped]

    @cached_property
    def demos(self) -> dict[str, Demonstrations]:
        """Return the demonstrations of every species."""
        return {one.cell.data: one.demos for one, _, _ in self.records}

    @cached_property
    def tests(self) -> dict[str, Demonstrations]:
        """Return the test split of every species."""
        return {name: demos.select(split="test") for name, demos in self.demos.items()}

    @cached_property
    def recorded(self) -> dict[str, pd.DataFrame]:
        """Return the measured recordings of every species."""
        return {name: measure_recordings(test) for name, test in self.tests.items()}

    def gather(self, rows: pd.DataFrame, species: str, key: str, counts: Any = True) -> Cells:
        """Return the values of rollouts by seed and start."""
        number_of = len(self.tests[species])
        if rows.empty:
            nothing = np.zeros(0, np.int64)
            return cells(nothing, nothing, nothing, number_of)
        return cells(rows[key], rows["seed"], rows["demo"], number_of, counts)

    # -- tables ------------------------------------------------------------------------------------

    @cached_property
    def table1(self) -> pd.DataFrame:
        """Return published, true and fitted locomotion, a row per individual and parameter."""
        paper, rows = published("table1"), []
        for name, demos in self.demos.items():
            fits = {method: fit_locomotion(demos, method, bootstrap=0) for method in (ONSET, JOINT)}
            for i, (individual, true) in enumerate(
                zip(demos.individuals, get_species(name).locomotion)
            ):
                for key, field in (
                    ("damping", "damping"),
                    ("thrust", "thrust"),
                    ("rmse", "velocity_rmse"),
                ):
                    row = {"species": name, "individual": individual, "parameter": key}
                    row["published"] = float(paper[name, individual, key])
                    row["true"] = getattr(true, key, np.nan)
                    for method, fit in fits.items():
                        row[method] = getattr(fit.individuals[i], field)
                    rows.append(row)
        return pd.DataFrame(rows)

    @cached_property
    def figure3(self) -> pd.DataFrame:
        """Return counts of speeds by bin, recorded and simulated by DQDIL-PT in either world."""
        parts = []
        for name, test in self.tests.items():
            edges = speed_edges(test)
            counts = {RECORDED: count_speeds(Rollouts.from_demonstrations(test), test)}
            for setting in (ONSET, JOINT):
                if made := self.of(name, setting, SIMULATED):
                    counts[setting] = np.sum([one.speeds for one in made], axis=0)
            parts.append(
                pd.DataFrame({"species": name, "low": edges[:-1], "high": edges[1:]} | counts)
            )
        return pd.concat(parts, ignore_index=True)

    @cached_property
    def figure4(self) -> pd.DataFrame:
        """Return shares reached and distances to the recordings, by learner and world."""
        paper, rows = published("figure4"), []
        for name, setting, learner in product(self.tests, (ONSET, JOINT), LEARNERS):
            own = self.rows(name, setting, learner)
            if own.empty:
                continue
            draws = Draws.by(np.random.default_rng(SEED))
            found = {
                TARGET_REACHED.key: bootstrap_mean(
                    self.gather(own, name, "captured"), draws, share=True
                ),
                DURATION.key: kde_interval(own, self.recorded[name], DURATION.key),
                PATH_LENGTH.key: kde_interval(own, self.recorded[name], PATH_LENGTH.key),
            }
            clone = self.rows(name, setting, "bc")
            if learner != "bc" and not clone.empty:
                pair = (self.gather(one, name, DTW.key) for one in (clone, own))
                found[DTW.key] = bootstrap_difference(*pair, draws)
            head = {"species": name, "setting": setting, "learner": learner}
            head["seeds"] = own["seed"].nunique()
            commits = {one.about["commit"] for one in self.of(name, setting, learner)}
            head["commit"] = " ".join(sorted(commit[:7] for commit in commits))
            rows += [
                row_of(value, **head, measure=key, published=paper.get((name, learner, key), ""))
                for key, value in found.items()
            ]
        return self._with_earlier(pd.DataFrame(rows, columns=FIGURE4_COLUMNS))

    def _with_earlier(self, table: pd.DataFrame) -> pd.DataFrame:
        """Take earlier rows where they have more seeds."""
        if self.kept is None or self.scope.quick or not (self.kept / EARLIER).exists():
            return table
        keys = ["species", "setting", "learner", "measure"]
        earlier = pd.read_csv(self.kept / EARLIER, keep_default_na=False)
        earlier[["value", "low", "high"]] = earlier[["value", "low", "high"]].astype(float)
        earlier = earlier[
            earlier["species"].isin(self.scope.species)
            & earlier["learner"].isin(self.scope.learners)
        ]
        both = pd.concat([table, earlier], ignore_index=True)
        most = both.groupby(keys[:3])["seeds"].transform("max")
        return both[both["seeds"] == most].drop_duplicates(keys)

    @cached_property
    def figure5(self) -> pd.DataFrame:
        """Return counterfactual path lengths and durations, shifts, errors and their truth."""
        paper, rows = published("figure5"), []
        for name, key in product(self.tests, (PATH_LENGTH.key, DURATION.key)):
            if not get_species(name).conditions:
                continue
            test = self.tests[name]
            recorded = self.recorded[name].assign(cue=NO_CUE)
            given = {(RECORDED, "–"): (recorded, pd.DataFrame())}
            if (truth := self.truth(name)) is not None:
                given[TRUTH, "–"] = truth
            for learner, setting in product(COUNTERFACTUAL, (ONSET, JOINT)):
                pair = tuple(self.rows(name, setting, learner, flip) for flip in (False, True))
                if not pair[0].empty:
                    given[learner, setting] = pair[0], pair[1]
            for (learner, setting), (factual, flipped) in given.items():
                draws = Draws.by(np.random.default_rng(SEED))
                found: dict[str, Interval] = {}
                means = []
                for condition in (0, 1):
                    of = test.condition == condition
                    own, other, true = (
                        self.gather(one, name, key).of(of) for one in (factual, flipped, recorded)
                    )
                    means.append(bootstrap_mean(own, draws))
                    found[f"condition {condition + 1}"] = means[-1]
                    if not flipped.empty:
                        found[f"{condition + 1} → {2 - condition}"] = bootstrap_difference(
                            own, other, draws
                        )
                    if learner != RECORDED:
                        error = bootstrap_difference(own, true, draws)
                        found[f"error, condition {condition + 1}"] = error
                found["condition 1 − 2"] = subtract(*means)
                head = {"species": name, "setting": setting, "learner": learner, "quantity": key}
                head["seeds"] = factual["seed"].nunique()
                for row, value in found.items():
                    place = (name, learner, row.partition(",")[0])
                    text = paper.get(place, "") if key == PATH_LENGTH.key else ""
                    rows.append(row_of(value, **head, measure=row, published=text))
        columns = ["species", "setting", "learner", "quantity", "seeds", "measure", "published"]
        return pd.DataFrame(rows, columns=[*columns, "value", "low", "high", "reason"])

    def truth(self, species: str) -> tuple[pd.DataFrame, pd.DataFrame] | None:
        """Return what the teams behind the demonstrations do, in their condition and the other."""
        teams, test = teams_of(self.demos[species]), self.tests[species]
        if teams is None:
            return None
        embodied = teams[0].embody(get_species(species))
        whole = [
            measure(
                roll_out_teams(
                    teams, embodied, test, name=TRUTH, seed=SEED, repetitions=5, condition=condition
                ),
                test,
            )
            for condition in (0, 1)
        ]
        acted = [
            pd.concat(
                one[test.condition[one["demo"].to_numpy()] == (condition ^ flip)]
                for condition, one in enumerate(whole)
            )
            for flip in (0, 1)
        ]
        return acted[0], acted[1]

    @cached_property
    def adapted(self) -> pd.DataFrame:
        """Return realism, verdict, share reached and DTW distance of clones by steps online."""
        rows = []
        settings = dict.fromkeys(one.setting for one, _, _ in self.records)
        for name, setting in product(self.tests, settings):
            if not setting.startswith(ADAPTED):
                continue
            for learner in ("soft-bc", *LEARNERS):
                made = self.of(name, setting, learner)
                if not made:
                    continue
                own = self.rows(name, setting, learner)
                words = Counter(one.about["verdict"] for one in made)
                head = {"species": name, "learner": learner, "seeds": len(made)}
                head["steps"] = int(setting.partition("-")[2])
                head["verdict"] = "; ".join(words)
                draws = Draws.by(np.random.default_rng(SEED))
                mean = bootstrap_mean(self.gather(own, name, "captured"), draws, share=True)
                found = {
                    "realism": Interval(float(np.mean([one.about["realism"] for one in made]))),
                    TARGET_REACHED.key: mean,
                    DTW.key: bootstrap_mean(self.gather(own, name, DTW.key), draws),
                }
                rows += [row_of(value, **head, measure=key) for key, value in found.items()]
        columns = ["species", "learner", "steps", "seeds", "verdict", "measure"]
        return pd.DataFrame(rows, columns=[*columns, "value", "low", "high", "reason"])


FIGURE4_COLUMNS = [
    "species",
    "setting",
    "learner",
    "seeds",
    "commit",
    "measure",
    "published",
    "value",
    "low",
    "high",
    "reason",
]


# -- figures ---------------------------------------------------------------------------------------


def violin(panel: Axes, place: int, values: Floats, colour: str) -> None:
    """Draw the density of values, some of them as dots, and their median."""
    if not len(values):
        return
    if np.ptp(values) > 0:
        shapes: Any = panel.violinplot(values, [place], widths=0.8, showextrema=False, points=40)
        for body in shapes["bodies"]:
            body.set(facecolor=colour, edgecolor=colour, alpha=0.35)
    shown = np.linspace(0, len(values) - 1, min(len(values), MOST_DOTS)).astype(int)
    dots = np.sort(values)[shown]
    aside = 0.1 * (np.modf(np.arange(len(dots)) * 0.6180339887498949)[0] - 0.5)
    panel.plot(
        place + aside,
        dots,
        ".",
        color=style.TEXT.hex,
        markersize=1.4,
        alpha=0.3,
        markeredgewidth=0,
        rasterized=True,
    )
    panel.plot(place, np.median(values), "o", color=colour, markeredgecolor=style.PAGE.hex)


def draw_violins(
    columns: Mapping[str, Mapping[str, tuple[pd.DataFrame, str]]], keys: Sequence[str]
) -> Figure:
    """Draw a column per title and a row per metric; groups are named, with rows and a colour."""
    labels = {metric.key: f"{metric.label} ({metric.unit})" for metric in (DURATION, PATH_LENGTH)}
    labels[DTW.key] = f"{DTW.label} ({DTW.unit})"
    with style.figure_style():
        size = (0.6 + 3.6 * len(columns), 2.7 * len(keys), len(keys), len(columns))
        figure, panels = style.new_figure(*size)
        panels = np.reshape(panels, (len(keys), len(columns)))
        for (row, key), (column, (title, groups)) in product(
            enumerate(keys), enumerate(columns.items())
        ):
            panel: Axes = panels[row, column]
            shown = {name: one for name, one in groups.items() if key in one[0]}
            for place, (rows, colour) in enumerate(shown.values()):
                violin(panel, place, rows[key].to_numpy(np.float64), colour)
            panel.grid(axis="y", color=style.LINE.hex, linewidth=0.5)
            panel.set_xticks(range(len(shown)), list(shown))
            panel.tick_params(axis="x", length=0, rotation=30, labelsize=7)
            panel.set_xlim(-0.6, max(len(shown), 1) - 0.4)
            panel.set_ylim(bottom=0)
            panel.set(ylabel=labels[key], title=title if row == 0 else "")
    return figure


def draw_figure4(found: Findings, setting: str) -> Figure:
    """Draw violins of duration above those of DTW distance, a column for each species."""
    columns = {}
    for name in found.tests:
        truth = found.recorded[name].drop(columns=DTW.key)
        groups = {RECORDED: (truth, style.method_colour(RECORDED))}
        for learner in LEARNERS:
            own = found.rows(name, setting, learner)
            if not own.empty:
                groups[style.method_label(learner)] = own, style.method_colour(learner)
        columns[PLURALS[name]] = groups
    return draw_violins(columns, (DURATION.key, DTW.key))


def shown_learners(species: str, main: bool) -> tuple[str, str]:
    """Return the two learners of Figure 5, or of Text S1."""
    suffix = "-pt" if PRETRAINED[species] == main else ""
    return f"dqdil{suffix}", f"dqcil{suffix}"


def draw_figure5(found: Findings, main: bool) -> Figure:
    """Draw violins of the means from each start: recorded, by condition, and under either cue."""
    columns = {}
    for name in PRETRAINED:
        if name not in found.tests:
            continue
        recorded, grey = found.recorded[name], style.method_colour(RECORDED)
        groups = {
            f"GT {condition + 1}": (recorded[recorded["condition"] == condition], grey)
            for condition in (0, 1)
        }
        for flip, learner, condition in (
            *product((False,), shown_learners(name, main), (0, 1)),
            *((True, learner, c) for c in (0, 1) for learner in shown_learners(name, main)),
        ):
            rows = found.rows(name, ONSET, learner, flip)
            if rows.empty:
                continue
            own = rows[rows["condition"] == condition]
            means = own.groupby("demo")[[PATH_LENGTH.key, DURATION.key]].mean()
            short = learner[2:5].upper()
            label = f"{short} {condition + 1}" + (f"→{2 - condition}" if flip else "")
            groups[label] = means, style.method_colour(learner)
        columns[PLURALS[name]] = groups
    return draw_violins(columns, (PATH_LENGTH.key, DURATION.key))


def draw_paths_above(
    columns: Sequence[tuple[str, str, Floats | None, Floats]],
) -> Figure:
    """Draw simulated paths above the recorded one, a column for each title and species."""
    with style.figure_style():
        width = 1.9 if len(columns) > 4 else 2.6
        figure, panels = style.new_figure(width * len(columns), 2 * width, 2, len(columns))
        panels = np.reshape(panels, (2, len(columns)))
        for column, (title, name, simulated, recorded) in enumerate(columns):
            species = get_species(name)
            drawn = [recorded if simulated is None else simulated, recorded]
            x, y, half = view_of(species.arena, recorded, *drawn)
            for row, path in enumerate(drawn):
                panel: Axes = panels[row, column]
                points = np.linspace(0, len(path) - 1, min(len(path), PATH_POINTS)).astype(int)
                if row or simulated is not None:
                    draw_paths(
                        panel, path[points], species.arena, species.roles, species.individuals
                    )
                panel.set_axis_off()
                panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
                panel.set_title(title if row == 0 else "recorded", fontsize=7.5)
    return figure


def draw_figure2(found: Findings) -> Figure:
    """Draw one test start of each species."""
    columns = []
    for name, test in found.tests.items():
        made = found.of(name, ONSET, SIMULATED)
        condition, start = next(iter(example_starts(test).items()))
        paths = [p for key, p in made[0].paths.items() if key[0] == str(condition)] if made else []
        columns.append((PLURALS[name], name, paths[0] if paths else None, test.path(start)))
    return draw_paths_above(columns)


def draw_figure6(found: Findings) -> Figure:
    """Draw one start under the given and the other cue: agents of condition 1, silkmoths of 2."""
    columns = []
    for name, condition in (("agent", 0), ("silkmoth", 1)):
        if name not in found.tests:
            continue
        recorded = found.tests[name].path(example_starts(found.tests[name])[condition])
        for cue, learner in product((condition, 1 - condition), shown_learners(name, True)):
            made = found.of(name, ONSET, learner)
            path = made[0].paths.get(f"{condition}-{cue}") if made else None
            label = f"{style.method_label(learner)}, {condition + 1}"
            label += "" if cue == condition else f" → {cue + 1}"
            columns.append((f"{PLURALS[name]}\n{label}", name, path, recorded))
    return draw_paths_above(columns)


def draw_figure3(found: Findings) -> Figure:
    """Draw histograms of speed, areas one."""
    with style.figure_style():
        figure, panels = style.new_figure(3.0 * len(found.tests), 2.4, 1, len(found.tests))
        for name, panel in zip(found.tests, np.atleast_1d(panels)):
            rows = found.figure3[found.figure3["species"] == name]
            edges = np.append(rows["low"], rows["high"].iloc[-1])
            for key, looks in (
                (RECORDED, {"fill": True, "color": style.FILL.hex, "alpha": 0.55}),
                (ONSET, {"color": style.BLUE.hex}),
                (JOINT, {"color": style.VERMILION.hex, "linestyle": (0, (3, 2))}),
            ):
                if key in rows and (total := rows[key].sum()):
                    shares = rows[key].to_numpy() / total / np.diff(edges)
                    panel.stairs(shares, edges, label=key, **looks)
            panel.set(xlabel="Speed (arena units/s)", title=PLURALS[name])
            panel.legend(fontsize=7)
    return figure


def draw_adapted(found: Findings) -> Figure:
    """Draw realism by steps online, a panel for each species; the clone is dashed."""
    table = found.adapted[found.adapted["measure"] == "realism"]
    with style.figure_style():
        figure, panels = style.new_figure(3.0 * len(found.tests), 2.4, 1, len(found.tests))
        for name, panel in zip(found.tests, np.atleast_1d(panels)):
            own = table[table["species"] == name]
            for value in own[own["steps"] == 0]["value"]:
                panel.axhline(value, **REFERENCE)
            for learner, rows in own[own["steps"] > 0].groupby("learner"):
                colour = style.method_colour(str(learner))
                label = style.method_label(str(learner))
                panel.plot(rows["steps"], rows["value"], "o-", color=colour, label=label)
            panel.set(xlabel="Steps online", ylabel="Realism", title=PLURALS[name])
            if panel.get_legend_handles_labels()[0]:
                panel.set_xscale("log")
                panel.legend(fontsize=7)
    return figure


def save_svg(figure: Figure, alt: str, file: Path) -> None:
    """Write a drawing on white ground; the same figure gives the same bytes."""
    head, bracket, body = style.to_image(figure, alt).drawing.partition(">")
    ground = '<rect width="100%" height="100%" fill="#ffffff"/>'
    file.write_text(f"{head}{bracket}{ground}{body}\n", encoding="utf-8")


# -- the page --------------------------------------------------------------------------------------


def label(learner: str) -> str:
    """Return a learner as tables name it."""
    return style.method_label(learner) if learner != TRUTH else TRUTH


def table1_page(found: Findings) -> tuple[str, str]:
    """Return Table 1 and a sentence on dampings."""
    rows, ratios = [], []
    for (name, individual), own in found.table1.groupby(["species", "individual"], sort=False):
        by = own.set_index("parameter")
        row = [PLURALS[str(name)], str(individual)]
        row += [
            ", ".join(number(value) for value in by[column])
            for column in ("published", "true", ONSET, JOINT)
        ]
        rows.append(row)
        ratios.append((str(name), by.loc["damping", ONSET] / by.loc["damping", "true"]))
    words = []
    for name in found.tests:
        own_ratios = [ratio for species, ratio in ratios if species == name]
        ends = dict.fromkeys(f"{end(own_ratios):.1f}" for end in (min, max))
        words.append(f"{PLURALS[name]} {' to '.join(ends)}")
    head = ("species", "individual", "published: d, u, RMSE", "true", "onset rule", "joint fit")
    sentence = (
        f"Damping by the onset rule over the true one: {', '.join(words)}. Its top speed is the "
        "top speed seen, and animals that stop before they reach their terminal speed seem damped "
        "more than they are."
    )
    return markdown_table(head, rows), sentence


def cell_of(row: pd.Series | None) -> str:
    """Return a value with its interval; a dash if there is none."""
    if row is None:
        return "–"
    return with_interval(Interval(row["value"], row["low"], row["high"]))


def wide(table: pd.DataFrame, keys: Sequence[str], columns: Mapping[str, bool]) -> list[list[str]]:
    """Return a row of texts per combination of keys: each measure, and where True the paper's."""
    lines = []
    for place, own in table.groupby(list(keys), sort=False):
        by = own.drop_duplicates("measure").set_index("measure")
        line = [
            PLURALS.get(str(one), label(str(one)) if key == "learner" else str(one))
            for key, one in zip(keys, place if isinstance(place, tuple) else (place,))
        ]
        for measured, beside in columns.items():
            row = by.loc[measured] if measured in by.index else None
            line.append(cell_of(row))
            if beside:
                line.append("" if row is None else str(row["published"]))
        lines.append(line)
    return lines


def figure4_page(found: Findings) -> tuple[str, str]:
    """Return the table of Figure 4 and what is nearest, here and in the paper."""
    columns = {TARGET_REACHED.key: False, DURATION.key: True, PATH_LENGTH.key: True, DTW.key: True}
    keys = ["species", "learner", "setting", "seeds", "commit"]
    head = ["species", "learner", "world", "seeds", "commit", "reached", "duration", "paper"]
    head += ["path length", "paper", "DTW below BC", "paper"]
    order = {learner: place for place, learner in enumerate(LEARNERS)}
    table = found.figure4.sort_values(
        ["species", "learner", "setting"],
        key=lambda column: column.map(order) if column.name == "learner" else column,
        kind="stable",
        ascending=[True, True, False],
    )
    paper, words = published("nearest"), []
    for (name, setting), own in found.figure4.groupby(["species", "setting"], sort=False):
        nearest = []
        for key in (DURATION.key, PATH_LENGTH.key):
            rows = own[own["measure"] == key]
            best = rows.loc[rows["value"].idxmin()]
            nearest.append(f"{label(best['learner'])} by {key.replace('_', ' ')} ({cell_of(best)})")
        theirs = next(value for (species, *_), value in paper.items() if species == name)
        words.append(
            f"- {PLURALS[str(name)]}, {setting} world: nearest to the recordings are "
            f"{' and '.join(nearest)}. In the paper, by duration: {theirs}."
        )
    reached = [
        f"{PLURALS[name]} {rows['reached'].mean():.2f}" for name, rows in found.recorded.items()
    ]
    words.append(f"- Share of test recordings that reach the target: {', '.join(reached)}.")
    return markdown_table(head, wide(table, keys, columns)), "\n".join(words)


def figure5_page(found: Findings, main: bool) -> str:
    """Return the table of Figure 5 or of Text S1."""
    table = found.figure5
    shown = [
        row["learner"] in (RECORDED, TRUTH, *shown_learners(row["species"], main))
        for row in table.to_dict("records")
    ]
    columns = {f"condition {i}": False for i in (1, 2)} | {"condition 1 − 2": True}
    columns |= {"1 → 2": True, "2 → 1": True} | {f"error, condition {i}": True for i in (1, 2)}
    head = ["species", "learner", "world", "quantity", "seeds"]
    head += [text for key, beside in columns.items() for text in (key, "paper")[: 1 + beside]]
    keys = ["species", "learner", "setting", "quantity", "seeds"]
    lines = wide(table[shown], keys, columns)
    for line in lines:
        line[3] = line[3].replace("_", " ")
    return markdown_table(head, lines)


def adapted_page(found: Findings) -> tuple[str, str]:
    """Return the table of adapted clones, and whether adapting helps, in one sentence."""
    table = found.adapted
    if table.empty:
        return "No cell of this table is finished yet.", (
            "Whether adapting online helps is still open: none of its cells is finished."
        )
    keys = ["species", "learner", "steps", "seeds", "verdict"]
    columns = {"realism": False, TARGET_REACHED.key: False, DTW.key: False}
    head = [*keys, "realism", "reached", "DTW distance"]
    words = []
    realism = table[table["measure"] == "realism"]
    for name, own in realism.groupby("species", sort=False):
        clone = own[own["steps"] == 0]["value"].mean()
        later = own[own["steps"] > 0]
        if later.empty or not np.isfinite(clone):
            continue
        best = later.loc[later["value"].idxmax()]
        helps = "raises" if best["value"] > clone else "does not raise"
        words.append(
            f"for {PLURALS[str(name)]} it {helps} the clone's realism ({number(clone)}; best "
            f"{number(best['value'])}, {label(best['learner'])} after {best['steps']:,} steps)"
        )
    sentence = f"Adapting online: {'; '.join(words)}." if words else ""
    return markdown_table(head, wide(table, keys, columns)), sentence


def scope_page(found: Findings) -> str:
    """Return how many seeds of each cell there are."""
    total = len(found.scope.seeds)
    lines = []
    for name in found.tests:
        line = [PLURALS[name]]
        for learner in LEARNERS:
            counts = [
                f"{len(found.of(name, setting, learner))}"
                for setting in found.scope.settings
                if setting != ADAPTED
            ]
            there = learner in found.scope.learners_of(name)
            line.append(" / ".join(counts) if there else "not defined: one condition")
        adapted = [record for one, record, _ in found.records if one.cell.data == name
                   and one.setting.startswith(ADAPTED)]  # fmt: skip
        line.append(f"{sum(one is not None for one in adapted)} of {len(adapted)} cells")
        lines.append(line)
    text = f"Seeds in the onset / joint world, of {total}"
    table = markdown_table([text, *map(label, LEARNERS), "adapted clones"], lines)
    if found.scope.quick:
        return f"**This is a quick try: a few episodes and steps. It says nothing.**\n\n{table}"
    return table


def cells_page(found: Findings) -> str:
    """Return where every record comes from; seconds of those made here are in ``costs.csv``."""
    rows: dict[tuple[str, ...], list[Record]] = {}
    for _, record, was_kept in found.records:
        if record is not None:
            about = record.about
            key = (PLURALS[about["species"]], label(about["learner"]), about["setting"],
                   f"{about['steps']:,}", about["commit"][:7], str(was_kept))  # fmt: skip
            rows.setdefault(key, []).append(record)
    lines = []
    for key, records in rows.items():
        seconds = ", ".join(str(one.about["processor_seconds"]) for one in records)
        seeds = ", ".join(str(one.about["seed"]) for one in records)
        lines.append([*key[:4], seeds, key[4], seconds if key[5] == "True" else "`costs.csv`"])
    head = ("species", "learner", "setting", "steps", "seeds", "commit", "processor seconds")
    return markdown_table(head, lines)


def estimate(cells_left: Iterable[PaperCell]) -> float:
    """Return about how many processor seconds cells take that have no record."""
    costs, total = published("cost"), 0.0
    for one in cells_left:
        if one.quick:
            total += 8.0
            continue
        if one.setting.startswith(ADAPTED):
            total += 120.0 + 2e-3 * one.steps
            continue
        seconds = float(costs[one.cell.data, one.cell.method, "seconds"])
        total += seconds * (one.steps / PAPER_STEPS if one.steps else 1.0)
    return total


def write_page(found: Findings, folder: Path) -> Path:
    """Write ``paper.md`` and ``results/paper`` with tables, figures and costs into a folder."""
    tables = {
        "table1": found.table1,
        "figure3": found.figure3,
        "figure4": found.figure4,
        "figure5": found.figure5,
        "adapted": found.adapted,
    }
    figures = {
        "figure2": (draw_figure2(found), "Simulated paths above recorded ones"),
        "figure3": (draw_figure3(found), "Histograms of speed"),
        "figure4": (draw_figure4(found, ONSET), "Durations and DTW distances, onset world"),
        "figure4-joint": (draw_figure4(found, JOINT), "Durations and DTW distances, joint world"),
        "adapted": (draw_adapted(found), "Realism of adapted clones by steps"),
    }
    conditions = [get_species(name).conditions for name in PRETRAINED if name in found.tests]
    if conditions:
        figures |= {
            "figure5": (draw_figure5(found, True), "Path lengths and durations by cue"),
            "text-s1": (draw_figure5(found, False), "Path lengths and durations by cue, Text S1"),
            "figure6": (draw_figure6(found), "Paths under the given and the other cue"),
        }
    left = [one for one, record, _ in found.records if record is None]
    adapted, helps = adapted_page(found)
    words = {
        "headline": helps,
        "scope": scope_page(found),
        "missing": missing_words(len(left), len(found.records), estimate(left)),
        "figure2_seed": f"seed {found.scope.seeds[0]}, the onset world",
        "figure5": figure5_page(found, True),
        "text_s1": figure5_page(found, False),
        "adapted": adapted,
        "adapted_figure": "![Realism by steps online](results/paper/adapted.svg)",
        "cells": cells_page(found),
    }
    for i in (0, 1):
        words[f"conditions{i + 1}"] = " or ".join(names[i] for names in conditions)
    words["table1"], words["table1_words"] = table1_page(found)
    words["figure4"], words["figure4_words"] = figure4_page(found)
    page = Template((HERE / "paper.md").read_text(encoding="utf-8")).substitute(words)
    costs = [record.about for _, record, _ in found.records if record is not None]
    with all_files_or_none(folder / RESULTS) as part:
        for name, table in tables.items():
            table.to_csv(part / f"{name}.csv", index=False, float_format="%.6g")
        pd.DataFrame(costs).to_csv(part / "costs.csv", index=False)
        for name, (figure, alt) in figures.items():
            save_svg(figure, alt, part / f"{name}.svg")
    (folder / "paper.md").write_text(page, encoding="utf-8")
    return folder / "paper.md"


def missing_words(left: int, total: int, seconds: float) -> str:
    """Return how far the page is."""
    if not left:
        return f"All {total} cells are there."
    return (
        f"{total - left} of {total} cells are there. The same command goes on; the rest takes "
        f"about {seconds / 3600:.1f} hours of processor time."
    )
