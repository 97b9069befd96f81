"""The page of the paper made anew: ``paper.md`` with its words and tables filled in."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.benchmark.departures import DEPARTED, PUBLISHED, SINGLE, TOGETHER
from animarl_algos.benchmark.paper import (
    ADAPTED,
    JOINT,
    LEARNERS,
    ONSET,
    PAPER_STEPS,
    SIMULATED,
    PaperCell,
    Scope,
)
from animarl_algos.benchmark.paper_figures import (
    PLURALS,
    PRETRAINED,
    compared_learners,
    draw_adapted,
    draw_departures,
    draw_figure2,
    draw_figure3,
    draw_figure4,
    draw_figure5,
    draw_figure6,
    save_svg,
)
from animarl_algos.benchmark.paper_tables import (
    DEFAULT,
    GAIN,
    REACHED,
    REACHED_GAIN,
    REALISM,
    TRUTH,
    Findings,
    published,
)
from animarl_algos.evaluation.metrics import DTW, DURATION, PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.learner.presets import learner_preset
from animarl_algos.report.style import method_label
from animarl_algos.report.words import number, with_interval
from animarl_envs import environment_id
from animarl_envs.drawing import markdown_table
from animarl_envs.files import all_files_or_none
from animarl_envs.species import get_species

RESULTS = Path("results") / "paper"
QUICK_SECONDS, DEPARTED_SECONDS, CLONE_SECONDS = 2.0, 20.0, 120.0  # of a cell
ADAPTING_SECONDS = 2e-3  # of a step
CAPTIONS = {
    "figure2": "Simulated paths above recorded ones",
    "figure3": "Histograms of speed",
    "figure4": "Durations and DTW distances by learner, in the onset world",
    "figure4-joint": "Durations and DTW distances by learner, in the joint world",
    "figure5": "Path lengths and durations of every start, by condition and cue",
    "figure6": "Paths of one start under the given and the other cue, above the recording",
    "text-s1": "As Figure 5: agents without pretraining, silkmoths with it",
    "adapted": "Realism of adapted clones by steps online",
    "departures": "Realism of DQDIL-PT by the rate of its pretraining",
}


def texts(table: pd.DataFrame, keys: Sequence[str], columns: Mapping[str, bool]) -> list[list[str]]:
    """Return a row of texts per combination of keys: each measure, and where True the paper's."""
    lines = []
    groups: Any = table.groupby(list(keys), sort=False)
    for place, own in groups:
        by = own.drop_duplicates("measure").set_index("measure")
        line = []
        for key, one in zip(keys, place):
            label = str(one).replace("_", " ")
            named = key == "learner" and one != TRUTH
            line.append(method_label(label) if named else PLURALS.get(label, label))
        for measured, beside in columns.items():
            row = by.loc[measured] if measured in by.index else None
            line.append("–" if row is None else value_of(row))
            if beside:
                line.append("" if row is None else str(row["published"]))
        lines.append(line)
    return lines


def value_of(row: Any) -> str:
    """Return a value with its interval."""
    return with_interval(Interval(row["value"], row["low"], row["high"]))


def table1_page(findings: Findings) -> dict[str, str]:
    """Return Table 1 and a sentence on dampings."""
    rows, ratios = [], dict[str, list[float]]()
    groups: Any = findings.table1.groupby(["species", "individual"], sort=False)
    for (name, individual), own in groups:
        kinds = ("published", "true", ONSET, JOINT)
        values = [", ".join(number(value) for value in own[kind]) for kind in kinds]
        rows.append([PLURALS[name], individual, *values])
        ratios.setdefault(PLURALS[name], []).append(own[ONSET].iloc[0] / own["true"].iloc[0])
    words = [
        f"{name} {' to '.join(dict.fromkeys(f'{end(own):.1f}' for end in (min, max)))}"
        for name, own in ratios.items()
    ]
    head = ("species", "individual", "published: d, u, RMSE", "true", "onset rule", "joint fit")
    sentence = f"Damping by the onset rule over the true one: {', '.join(words)}."
    return {"table1": markdown_table(head, rows), "table1_words": sentence}


def figure4_page(findings: Findings) -> dict[str, str]:
    """Return the table of Figure 4 and what is nearest, here and in the paper."""
    columns = {REACHED: False, DURATION.key: True, PATH_LENGTH.key: True, DTW.key: True}
    keys = ["species", "learner", "setting", "seeds", "commit"]
    head = [*keys[:2], "world", *keys[3:], REACHED, "duration", "paper", "path length", "paper"]
    order = [*findings.tests, *LEARNERS, ONSET, JOINT].index
    table = findings.figure4.sort_values(
        keys[:3], key=lambda column: column.map(order), kind="stable"
    )
    theirs = {species: value for (species, *_), value in published("nearest").items()}
    words = []
    groups: Any = table.groupby(["species", "setting"], sort=False)
    for (name, setting), own in groups:
        nearest = []
        for key in (DURATION.key, PATH_LENGTH.key):
            rows = own[own["measure"] == key]
            best = rows.loc[rows["value"].idxmin()]
            by = key.replace("_", " ")
            nearest.append(f"{method_label(best['learner'])} by {by} ({value_of(best)})")
        words.append(
            f"- {PLURALS[name]}, {setting} world: nearest to the recordings are "
            f"{' and '.join(nearest)}. In the paper, by duration: {theirs[name]}."
        )
    shares = [
        f"{PLURALS[name]} {rows[REACHED].mean():.2f}" for name, rows in findings.recorded.items()
    ]
    words.append(f"- Share of test recordings that reach the target: {', '.join(shares)}.")
    lines = texts(table, keys, columns)
    return {
        "figure4": markdown_table([*head, "DTW below BC", "paper"], lines),
        "figure4_words": "\n".join(words),
    }


def figure5_page(findings: Findings, main: bool) -> str:
    """Return the table of Figure 5 or of Text S1."""
    columns = {f"condition {i}": False for i in (1, 2)} | {"condition 1 − 2": True}
    columns |= {"1 → 2": True, "2 → 1": True}
    columns |= {"error, condition 1": False, "error, condition 2": True}
    keys = ["species", "learner", "setting", "quantity", "seeds"]
    head = [*keys[:2], "world", *keys[3:]]
    head += [text for key, beside in columns.items() for text in (key, "paper")[: 1 + beside]]
    table = findings.figure5
    pairs = zip(table["species"], table["learner"])
    chosen = [one in (RECORDED, TRUTH, *compared_learners(name, main)) for name, one in pairs]
    return markdown_table(head, texts(table[np.array(chosen, dtype=bool)], keys, columns))


def adapted_page(findings: Findings) -> dict[str, str]:
    """Return the table of adapted clones, verdicts by seed, and whether adapting helps."""
    keys = ["species", "learner", "steps", "seeds"]
    columns = dict.fromkeys((REALISM, GAIN, REACHED, REACHED_GAIN, DTW.key), False)
    table = findings.adapted
    sentence = "Whether adapting online helps is open here: none of its cells is finished."
    gains = table[table["measure"] == GAIN]
    if len(gains):
        realism, reached = (
            clear_counts(table[table["measure"] == key]) for key in (GAIN, REACHED_GAIN)
        )
        sentence = f"Does adapting online help? By realism {realism}; "
        sentence += f"by the share that reaches the target {reached}."
        if table["seeds"].min() < len(Scope().seeds):
            sentence += " Some have one or two training seeds, which leaves that open."
    verdicts, seeds = [], findings.scope.seeds
    rows: Any = table.drop_duplicates(keys)[keys]
    for name, learner, steps, _ in rows.itertuples(index=False):
        made = findings.of(name, f"{ADAPTED}-{steps}", learner)
        words_by_seed = {one.about["seed"]: one.about["verdict"] for one in made}
        line = [PLURALS[name], method_label(learner), f"{steps:,}"]
        verdicts.append([*line, *(words_by_seed.get(seed, "") for seed in seeds)])
    head = [*keys, REALISM, "above the clone", REACHED, "above the clone", "DTW distance"]
    return {
        "adapted": markdown_table(head, texts(table, keys, columns)),
        "verdicts": markdown_table([*keys[:3], *(f"seed {seed}" for seed in seeds)], verdicts),
        "headline": sentence,
    }


def clear_counts(gains: pd.DataFrame) -> str:
    """Return how many adapted clones lie clearly above and below their clone."""
    above, below = gains["low"] > 0, gains["high"] < 0
    words = f"{above.sum()} of {len(gains)} adapted clones lie clearly above the clone"
    groups: Any = above.groupby(gains["species"], sort=False)
    parts = [f"{own.sum()} of {PLURALS[name]}" for name, own in groups]
    return f"{words} ({', '.join(parts)}) and {below.sum()} below"


def updates_page(findings: Findings) -> str:
    """Return how many updates the published settings make, and how far they move a weight."""
    lines = []
    for name, demos in {one.cell.data: one.demos for one, _, _ in findings.records}.items():
        alone, after = (
            learner_preset(learner, environment_id(name), "paper").settings
            for learner in (SIMULATED.removesuffix("-pt"), SIMULATED)
        )
        batches = -(-int((demos.split == "train").sum()) // after.offline_batch_size)
        offline = batches * after.offline_epochs
        online = PAPER_STEPS // get_species(name).time_limit
        moves = (
            (offline, after.offline_learning_rate),
            (online, alone.learning_rate),
            (online, after.learning_rate),
        )
        lines.append([PLURALS[name], *(f"{n:,} × {rate:g} = {n * rate:.2g}" for n, rate in moves)])
    head = ("species", "pretraining", "online, without pretraining", "online, after pretraining")
    return markdown_table(head, lines)


def departures_page(findings: Findings) -> dict[str, str]:
    """Return DQDIL-PT with published and with other settings, and how much that helps."""
    table, words, shares = findings.departures, [], list[list[float]]()
    chosen = table[table["departure"].isin((*SINGLE, *TOGETHER, DEFAULT))]
    realism = chosen[chosen["measure"] == REALISM]
    groups: Any = realism.groupby("species", sort=False)
    for name, own in groups:
        by = own.set_index("departure")["value"]
        there = [by[by.index.isin(some)] for some in (SINGLE[1:], TOGETHER)]
        if min(map(len, there)) == 0 or not {PUBLISHED, DEFAULT} <= set(by.index):
            continue
        gap = by[DEFAULT] - by[PUBLISHED]
        shares.append([(some.max() - by[PUBLISHED]) / gap for some in there])
        best = [
            f"'{some.idxmax()}' ({number(some.max())}) {share:.0%}"
            for some, share in zip(there, shares[-1])
        ]
        words.append(
            f"- {PLURALS[name]}: of the gap from published settings ({number(by[PUBLISHED])}) to "
            f"preset default ({number(by[DEFAULT])}), {best[0]}, {best[1]}."
        )
    lead = ""
    if shares:
        single, several = zip(*shares)
        lead = (
            f"**A single departure closes {min(single):.0%} to {max(single):.0%} of the gap in "
            f"realism between published settings and preset `default`, the best of two or three "
            f"{min(several):.0%} to {max(several):.0%}.**"
        )
    columns = {REACHED: False, DURATION.key: False, PATH_LENGTH.key: False, DTW.key: False}
    keys = ["species", "departure", "seeds"]
    head = [*keys, REACHED, "duration", "path length", "DTW distance", REALISM]
    return {
        "departures": markdown_table(head, texts(chosen, keys, columns | {REALISM: False})),
        "departures_lead": lead,
        "departures_words": "\n".join(words),
    }


def scope_page(findings: Findings) -> str:
    """Return how many seeds of each cell there are."""
    total, lines = len(findings.scope.seeds), []
    worlds = [setting for setting in (ONSET, JOINT) if setting in findings.scope.settings]
    for name in findings.tests:
        line = [PLURALS[name]]
        for learner in LEARNERS:
            there = learner in findings.scope.learners_of(name)
            counts = [str(len(findings.of(name, setting, learner))) for setting in worlds]
            line.append(" / ".join(counts) if there else "one condition")
        clones = [
            record
            for one, record, _ in findings.records
            if one.cell.data == name and one.setting.startswith(ADAPTED)
        ]
        lines.append(
            [*line, f"{sum(record is not None for record in clones)} of {len(clones)} cells"]
        )
    head = [f"Seeds in the {' / '.join(worlds)} world, of {total}", *map(method_label, LEARNERS)]
    quick = "**This is a quick try: a few episodes and steps. It says nothing.**\n\n"
    return (quick if findings.scope.quick else "") + markdown_table(
        [*head, "adapted clones"], lines
    )


def cells_page(findings: Findings) -> str:
    """Return which commits made how many cells; ``costs.csv`` has a row for each of them."""
    lines = []
    of_kind: Any = pd.DataFrame(
        [
            (PLURALS[one.cell.data], one.setting.partition("-")[0], record.about["commit"][:7])
            for one, record, _ in findings.records
            if record is not None
        ],
        columns=["species", "setting", "commit"],
    ).groupby(["species", "setting"], sort=False)
    for kind, own in of_kind:
        commits = own["commit"].value_counts(sort=False).items()
        lines.append([*kind, ", ".join(f"{commit} ({count})" for commit, count in commits)])
    return markdown_table(["species", "setting", "commits (cells)"], lines)


def estimate(left: Iterable[PaperCell]) -> float:
    """Return about how many processor seconds cells without a record take."""
    costs, total = published("cost"), 0.0
    for one in left:
        if one.quick:
            total += QUICK_SECONDS
        elif one.setting.startswith(DEPARTED):
            total += DEPARTED_SECONDS
        elif one.setting.startswith(ADAPTED):
            total += CLONE_SECONDS + ADAPTING_SECONDS * one.steps
        else:
            seconds = float(costs[one.cell.data, one.cell.method, "seconds"])
            total += seconds * (one.steps / PAPER_STEPS if one.steps else 1.0)
    return total


def write_page(findings: Findings, folder: Path) -> Path:
    """Write ``paper.md`` and ``results/paper`` with tables, figures and costs into a folder."""
    figures = {
        "figure2": draw_figure2(findings),
        "figure3": draw_figure3(findings),
        "figure4": draw_figure4(findings, ONSET),
        "figure4-joint": draw_figure4(findings, JOINT),
        "adapted": draw_adapted(findings),
        "departures": draw_departures(findings),
    }
    conditions = [get_species(name).conditions for name in PRETRAINED if name in findings.tests]
    if conditions:
        figures["figure5"], figures["text-s1"] = (draw_figure5(findings, m) for m in (True, False))
        figures["figure6"] = draw_figure6(findings)
    left = [one for one, record, _ in findings.records if record is None]
    there = f"{len(findings.records) - len(left)} of {len(findings.records)} cells are there."
    rest = f" The same command makes the rest in about {estimate(left) / 3600:.1f} processor hours."
    words = table1_page(findings) | figure4_page(findings) | adapted_page(findings)
    words |= departures_page(findings)
    words |= {
        "scope": scope_page(findings),
        "updates": updates_page(findings),
        "missing": there + (rest if left else ""),
        "figure5": figure5_page(findings, True),
        "text_s1": figure5_page(findings, False),
        "simulated": method_label(SIMULATED),
        "seed": str(findings.scope.seeds[0]),
        "cells": cells_page(findings),
    }
    for name, caption in CAPTIONS.items():
        picture = f"![{caption}]({RESULTS.as_posix()}/{name}.svg)"
        words[f"{name.replace('-', '_')}_svg"] = picture if name in figures else ""
    for i in (0, 1):
        words[f"conditions{i + 1}"] = " or ".join(names[i] for names in conditions)
    page = Template(Path(__file__).with_name("paper.md").read_text(encoding="utf-8"))
    costs = pd.DataFrame([record.about for _, record, _ in findings.records if record])
    with all_files_or_none(folder / RESULTS) as part:
        costs.to_csv(part / "costs.csv", index=False)
        for name in ("table1", "figure3", "figure4", "figure5", "adapted", "departures"):
            table = getattr(findings, name)
            table = table if table.empty else table.dropna(axis="columns", how="all")
            table.to_csv(part / f"{name}.csv", index=False, float_format="%.6g")
        for name, figure in figures.items():
            save_svg(figure, CAPTIONS[name], part / f"{name}.svg")
    (folder / "paper.md").write_text(page.substitute(words), encoding="utf-8")
    return folder / "paper.md"
