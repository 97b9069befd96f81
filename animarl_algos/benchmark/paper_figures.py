"""Figures of the paper made anew, in its arrangement, as drawings of text and lines."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from animarl_algos.benchmark.departures import LOSSES, PUBLISHED, RATES, at_rate
from animarl_algos.benchmark.paper import JOINT, LEARNERS, ONSET, SIMULATED, example_starts
from animarl_algos.benchmark.paper_tables import DEFAULT, REALISM, Findings
from animarl_algos.evaluation.metrics import DTW, DURATION, PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.report import style
from animarl_algos.report.figures import GOLDEN_RATIO, REFERENCE, draw_paths, view_of
from animarl_envs.array_types import Floats
from animarl_envs.species import get_species

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PLURALS = {"agent": "agents", "fly": "flies", "newt": "newts", "silkmoth": "silkmoths"}
PRETRAINED = {"agent": True, "silkmoth": False}  # of Figure 5; Text S1 has the others
PANEL = (3.4, 2.6)  # [inch]
MOST_DOTS, MOST_POINTS = 100, 150  # of a violin and of a path
Groups = Mapping[str, tuple[pd.DataFrame, str]]


def violin(panel: Axes, place: int, values: Floats, colour: str) -> None:
    """Draw the density of values, some of them as dots, and their median."""
    if np.ptp(values) > 0:
        shapes: Any = panel.violinplot(values, [place], widths=0.8, showextrema=False, points=30)
        for body in shapes["bodies"]:
            body.set(facecolor=colour, edgecolor=colour, alpha=0.35)
    kept = np.linspace(0, len(values) - 1, min(len(values), MOST_DOTS)).astype(int)
    aside = 0.1 * ((np.arange(len(kept)) * GOLDEN_RATIO) % 1.0 - 0.5)
    dots: dict[str, Any] = {"markersize": 1.4, "alpha": 0.3, "rasterized": True}
    dots |= {"color": style.TEXT.hex, "markeredgewidth": 0}
    panel.plot(place + aside, np.sort(values)[kept], ".", **dots)
    panel.plot(place, np.median(values), "o", color=colour, markeredgecolor=style.PAGE.hex)


def draw_violins(columns: Mapping[str, Groups], rows: Sequence[str]) -> Figure:
    """Draw a column per title and a row per metric; groups are named, with values and a colour."""
    labels = {one.key: f"{one.label} ({one.unit})" for one in (DURATION, PATH_LENGTH, DTW)}
    with style.figure_style():
        across, down = len(columns), len(rows)
        figure, panels = style.new_figure(PANEL[0] * across, PANEL[1] * down, down, across)
        panels = np.reshape(panels, (down, across))
        for (row, key), (column, title) in product(enumerate(rows), enumerate(columns)):
            panel: Axes = panels[row, column]
            kept = {name: one for name, one in columns[title].items() if key in one[0]}
            for place, (values, colour) in enumerate(kept.values()):
                violin(panel, place, values[key].to_numpy(np.float64), colour)
            panel.grid(axis="y", color=style.LINE.hex, linewidth=0.5)
            panel.set_xticks(range(len(kept)), list(kept))
            panel.tick_params(axis="x", length=0, rotation=30, labelsize=7)
            panel.set_ylim(bottom=0)
            panel.set(ylabel=labels[key], title="" if row else title)
    return figure


def draw_figure4(findings: Findings, setting: str) -> Figure:
    """Draw violins of duration above those of DTW distance, a column for each species."""
    columns = {}
    for name, truth in findings.recorded.items():
        groups = {RECORDED: (truth.drop(columns=DTW.key), style.method_colour(RECORDED))}
        for learner in LEARNERS:
            if len(own := findings.rows(name, setting, learner)):
                groups[style.method_label(learner)] = own, style.method_colour(learner)
        columns[PLURALS[name]] = groups
    return draw_violins(columns, (DURATION.key, DTW.key))


def compared_learners(species: str, main: bool) -> tuple[str, str]:
    """Return the two learners of Figure 5, or of Text S1."""
    suffix = "-pt" if PRETRAINED[species] == main else ""
    return f"dqdil{suffix}", f"dqcil{suffix}"


def draw_figure5(findings: Findings, main: bool) -> Figure:
    """Draw violins of the means from each start: recorded, by condition, and under either cue."""
    columns = {}
    for name in PRETRAINED:
        if name not in findings.tests:
            continue
        learners, groups = compared_learners(name, main), dict[str, tuple[pd.DataFrame, str]]()
        order = [(RECORDED, False), *product(learners, (False, True))]
        for learner, flip in sorted(order, key=lambda one: one[1]):
            real = learner == RECORDED
            rows = findings.recorded[name] if real else findings.rows(name, ONSET, learner, flip)
            for condition in (0, 1) if len(rows) else ():
                own = rows[rows["condition"] == condition].groupby("demo")
                short = "GT" if real else learner[2:5].upper()
                label = f"{short} {condition + 1}" + (f"→{2 - condition}" if flip else "")
                means = own[[PATH_LENGTH.key, DURATION.key]].mean()
                groups[label] = means, style.method_colour(learner)
        columns[PLURALS[name]] = groups
    return draw_violins(columns, (PATH_LENGTH.key, DURATION.key))


def draw_paths_above(columns: Sequence[tuple[str, str, Floats | None, Floats]]) -> Figure:
    """Draw simulated paths above the recorded one; columns are title, species and both paths."""
    with style.figure_style():
        width = 1.9 if len(columns) > 4 else 2.6
        figure, panels = style.new_figure(width * len(columns), 2 * width, 2, len(columns))
        for (title, name, simulated, recorded), pair in zip(
            columns, np.reshape(panels, (2, len(columns))).T
        ):
            species = get_species(name)
            known = [recorded] if simulated is None else [recorded, simulated]
            x, y, half = view_of(species.arena, *known)
            for panel, path, head in zip(pair, (simulated, recorded), (title, RECORDED)):
                if path is not None:
                    kept = np.linspace(0, len(path) - 1, min(len(path), MOST_POINTS)).astype(int)
                    names = species.roles, species.individuals
                    draw_paths(panel, path[kept], species.arena, *names)
                panel.set_axis_off()
                panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
                panel.set_title(head, fontsize=7.5)
    return figure


def draw_figure2(findings: Findings) -> Figure:
    """Draw one test start of each species."""
    columns = []
    for name, test in findings.tests.items():
        made = findings.of(name, ONSET, SIMULATED)
        path = next(iter(made[0].paths.values())) if made else None
        columns.append((PLURALS[name], name, path, test.path(example_starts(test)[0])))
    return draw_paths_above(columns)


def draw_figure6(findings: Findings) -> Figure:
    """Draw one start under the given and the other cue: agents of condition 1, silkmoths of 2."""
    columns = []
    for name, condition in (("agent", 0), ("silkmoth", 1)):
        if name not in findings.tests:
            continue
        recorded = findings.tests[name].path(example_starts(findings.tests[name])[condition])
        for cue, learner in product((condition, 1 - condition), compared_learners(name, True)):
            made = findings.of(name, ONSET, learner)
            path = made[0].paths.get(f"{condition}-{cue}") if made else None
            title = f"{PLURALS[name]}\n{style.method_label(learner)}, {condition + 1}"
            title += "" if cue == condition else f" → {cue + 1}"
            columns.append((title, name, path, recorded))
    return draw_paths_above(columns)


def panels_by_species(
    findings: Findings, legend: Mapping[str, Any] | None = None, **labels: str
) -> tuple[Figure, Iterator[tuple[str, Any]]]:
    """Return a figure of one row, and its species with their panels; a legend ends each.

    Where its place is given, the last panel alone has it.
    """
    figure, panels = style.new_figure(
        PANEL[0] * len(findings.tests), PANEL[1], 1, len(findings.tests)
    )

    def each() -> Iterator[tuple[str, Any]]:
        for name, panel in zip(findings.tests, np.atleast_1d(panels)):
            yield name, panel
            panel.set(title=PLURALS[name], **labels)
            wanted = legend is None or name == [*findings.tests][-1]
            if wanted and panel.get_legend_handles_labels()[0]:
                panel.legend(fontsize=7, **(legend or {}))

    return figure, each()


def draw_figure3(findings: Findings) -> Figure:
    """Draw histograms of speed, areas one."""
    looks: dict[str, dict[str, Any]] = {
        RECORDED: {"fill": True, "color": style.FILL.hex, "alpha": 0.55},
        ONSET: {"color": style.BLUE.hex},
        JOINT: {"color": style.VERMILION.hex, "linestyle": (0, (3, 2))},
    }
    with style.figure_style():
        figure, panels = panels_by_species(findings, xlabel="Speed (arena units/s)")
        for name, panel in panels:
            rows = findings.figure3[findings.figure3["species"] == name]
            edges = np.append(rows["low"], rows["high"].iloc[-1])
            for key in looks:
                if key in rows and (total := rows[key].sum()):
                    shares = rows[key].to_numpy() / total / np.diff(edges)
                    panel.stairs(shares, edges, label=key, **looks[key])
    return figure


def draw_adapted(findings: Findings) -> Figure:
    """Draw realism by steps online, a panel for each species; the clone is dashed."""
    table = findings.adapted[findings.adapted["measure"] == REALISM]
    with style.figure_style():
        figure, panels = panels_by_species(findings, xlabel="Steps online", ylabel="Realism")
        for name, panel in panels:
            own = table[table["species"] == name]
            groups: Any = own.groupby("learner")
            for learner, rows in groups:
                if (rows["steps"] == 0).all():
                    panel.axhline(rows["value"].iloc[0], **REFERENCE)
                    continue
                looks = {"color": style.method_colour(learner), "marker": "o"}
                label = style.method_label(learner)
                panel.semilogx(rows["steps"], rows["value"], label=label, **looks)
            panel.xaxis.set_major_formatter("{x:,.0f}")  # SVG text has no superscripts
    return figure


def draw_departures(findings: Findings) -> Figure:
    """Draw realism by the rate of pretraining, a line for each loss, between two presets."""
    table = findings.departures[findings.departures["measure"] == REALISM]
    colours = (style.BLUE, style.GREEN, style.VERMILION)
    with style.figure_style():
        beside = {"loc": "center left", "bbox_to_anchor": (1.02, 0.5)}
        labels = {"xlabel": "Rate of pretraining", "ylabel": "Realism"}
        figure, panels = panels_by_species(findings, beside, **labels)
        for name, panel in panels:
            own = table[table["species"] == name].set_index("departure")["value"]
            for preset, dashes in ((PUBLISHED, (0, (1, 2))), (DEFAULT, (0, (5, 2)))):
                if preset in own:
                    panel.axhline(own[preset], **REFERENCE | {"linestyle": dashes}, label=preset)
            for loss, colour in zip(LOSSES, colours):
                values = [own.get(at_rate(loss, rate), np.nan) for rate in RATES]
                if np.isfinite(values).any():
                    panel.semilogx(RATES, values, "o-", color=colour.hex, label=loss)
            panel.xaxis.set_major_formatter("{x:g}")  # SVG text has no superscripts
    return figure


def save_svg(figure: Figure, alt: str, file: Path) -> None:
    """Write a drawing on white ground; the same figure gives the same bytes."""
    head, bracket, body = style.to_image(figure, alt).drawing.partition(">")
    # Hundredths of a point and no indentation: a quarter of the bytes less.
    body = re.sub(r' d="[^"]*"', lambda path: re.sub(r"(\.\d\d)\d+", r"\1", path[0]), body)
    body = re.sub(r"\n +", "\n", body)
    ground = '<rect width="100%" height="100%" fill="#ffffff"/>'
    file.write_text(f"{head}{bracket}{ground}{body}\n", encoding="utf-8")
