"""The page of a run, or of several: sections of figures, tables and sentences, in order."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.headline import list_implausible
from animarl_algos.evaluation.metrics import DTW, METRICS, Metric
from animarl_algos.evaluation.prepared import CELLS, Prepared
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict_rows import lower_first
from animarl_algos.report import figures
from animarl_algos.report.figures import path_panels
from animarl_algos.report.inputs import ReportInputs, provenance
from animarl_algos.report.page import Block, Gallery, Page, Section, Text, write_page
from animarl_algos.report.player import examples, factual_rollouts, run_player
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.verdict_section import comparison_as_table, verdict_blocks, verdict_lead
from animarl_algos.report.words import NOTHING, cautions, number, pick, scaled
from animarl_envs.array_types import Floats
from animarl_envs.focus import nearest_other

QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the DTW distance, for the examples


def run_page(inputs: ReportInputs) -> Page:
    """Return the page: the verdict and the player, then every section that has blocks."""
    demos, evaluation = inputs.demos, inputs.evaluation
    judged = evaluation.verdict
    off = list_implausible(judged.rows(), judged.worse_than_untrained)
    cautionary = [*map(inputs.words.adapt, off), *inputs.warnings]
    cautionary += cautions(evaluation.comparison, inputs.learner, demos.synthetic)
    episodes = [(f"{split} episodes", str(count)) for split, count in inputs.episodes.items()]
    statistics = [
        ("resamples of means and differences", f"{evaluation.resamples:,}"),
        ("seed of the resampling", str(evaluation.seed)),
        ("training seeds", ", ".join(map(str, inputs.seeds)) or "not given"),
    ]
    crossed = f", cross-validated in {inputs.folds} folds" if inputs.folds else ""
    tested = f"{demos.num_episodes} recording{'s' * (demos.num_episodes != 1)}"
    facts = [
        ("Animals", str(demos.num_individuals) if demos.is_group else inputs.animals),
        ("Evaluated on", inputs.words.adapt(f"{tested}{crossed}")),
        ("Method", method_label(inputs.learner)),
        ("Training seeds", ", ".join(map(str, inputs.seeds)) or NOTHING),
    ]
    return Page(
        title=inputs.title,
        kind="Simulation report",
        synthetic=demos.synthetic,
        facts=facts + ([("Made", inputs.created)] if inputs.created else []),
        lead=verdict_lead(judged, inputs.words, list(dict.fromkeys(cautionary))),
        player=run_player(inputs),
        sections=[
            Section(
                "verdict", "Verdict", [*verdict_blocks(judged, inputs.words), *_processor(inputs)]
            ),
            Section("trajectories", "Trajectories", list(_trajectories(inputs))),
            Section(
                "distributions",
                "Speeds and distances",
                [*_distributions(inputs), *_places(inputs)],
            ),
            Section("metrics", "Metrics", list(_metrics(inputs))),
            Section(
                "provenance",
                "How this was made",
                list(provenance(inputs, "run", episodes, statistics)),
                "Command, settings, machine, versions",
            ),
        ],
    )


def write_report(inputs: ReportInputs, out: str | Path) -> Path:
    """Write the report to ``out``, whole or not at all, and return the path."""
    return write_page(run_page(inputs), Path(out))


def _processor(inputs: ReportInputs) -> Iterator[Block]:
    """Yield the processor of the run, and how far its results move without another training."""
    processor = inputs.machine.get("processor")
    if not processor:
        return
    sentences = [
        f"Made on {processor}.",
        "Another processor rounds differently, so that the same command trains another network.",
    ]
    if ranges := repetition_ranges(inputs):
        sentences.append(
            "Expect at least the range that other random numbers give, which is that of the "
            f"repetitions from the same starts: {', '.join(ranges)}."
        )
    yield Text(" ".join(sentences))


def repetition_ranges(inputs: ReportInputs) -> list[str]:
    """Return the range over seeds and repetitions of means over all starts, by metric, in words.

    Metrics that do not vary between repetitions are left out.
    """
    rows = inputs.evaluation.metrics.query("factual")
    rows = rows[rows["method"] == inputs.learner]
    starts = rows.groupby(["seed", "repetition"])["demo"].nunique()
    complete = rows.set_index(["seed", "repetition"]).loc[starts[starts == starts.max()].index]
    ranges = []
    for metric in (one for one in METRICS if one.caption and one.key in rows):
        means = complete.groupby(level=[0, 1])[metric.key].mean()
        scale = 100.0 if metric.share else inputs.words.factor(metric)
        low, high = (number(scale * float(end)) for end in (means.min(), means.max()))
        if low != high:
            unit = inputs.words.unit_of(metric)
            ranges.append(f"{lower_first(metric.label)} {low} to {high} {unit}".rstrip())
    return ranges


def _trajectories(inputs: ReportInputs) -> Iterator[Block]:
    rollouts, dtw = factual_rollouts(inputs)
    words = inputs.words
    source = (
        "; the cross is the source, and paths that leave the window are cut"
        if "searcher" in inputs.demos.roles
        else ""
    )
    for condition, chosen in examples(inputs, QUANTILES):
        images = []
        for i in chosen:
            demo = int(rollouts.demo[i])
            distance = f"DTW {number(dtw[i] * words.factor(DTW))}"
            ending = ""
            if inputs.demos.has_goal:
                ending = ",\nreached" if rollouts.captured[i] else ",\nnot reached"
            recorded = inputs.demos.episode(demo).positions
            figure = path_panels(
                [("simulated", rollouts.path(i)), (inputs.recorded, recorded)],
                recorded,
                inputs.stage,
                f"start {demo}: {distance}{ending}",
                below=True,
            )
            what = words.adapt(f"Simulated and recorded paths of test recording {demo}")
            images.append(to_image(figure, f"{what}, {distance} {words.unit_of(DTW)}"))
        where = f" Condition: {condition}." if condition else ""
        yield Gallery(
            images,
            words.adapt(
                f"{method_label(inputs.learner)} above the recording that each rollout started "
                f"from.{where} Chosen by rank, not by eye: from left to right the rollouts nearest "
                "to the 10th, 30th, 50th, 70th and 90th percentile of the DTW distance to the "
                f"recording ({words.unit_of(DTW)}), no two from one start, so the first are among "
                "the best and the last among the worst. Open marks are starts, filled ones "
                f"ends{source}."
            ),
            strip=True,
        )


def _distributions(inputs: ReportInputs) -> Iterator[Block]:
    """Speeds by role, and distances to the nearest other where there are others."""
    simulated, recorded = factual_rollouts(inputs)[0], Rollouts.from_demonstrations(inputs.demos)
    roles, words = np.array(inputs.demos.roles), inputs.words
    panels: list[tuple[str, str, Floats, Floats]] = []
    for role in dict.fromkeys(inputs.demos.roles):
        chosen = roles == role
        kind = role.capitalize() if inputs.demos.has_goal else "Animal"
        one, other = (side.speeds()[:, chosen] for side in (simulated, recorded))
        panels.append((kind + "s" * int(chosen.sum() > 1), f"Speed ({words.speed})", one, other))
    if len(roles) > 1:
        one, other = (
            np.linalg.norm(nearest_other(side.positions), axis=-1) for side in (simulated, recorded)
        )
        panels.append(("Nearest other", f"Distance ({words.unit.name})", one, other))
    images = []
    for title, axis, first, second in panels:
        one, other = (words.unit.per_arena_unit * side.ravel() for side in (first, second))
        figure = figures.histograms(one, other, axis, title, words.adapt("recorded"))
        alt = words.adapt(f"Histogram of {axis}: {title}, simulated over recorded")
        images.append(to_image(figure, alt))
    yield Gallery(
        images,
        words.adapt(
            "Speed of every step and distance to the nearest other in every frame, recorded "
            f"(filled) and simulated by {method_label(inputs.learner)} (line), all episodes, on "
            f"shared bins; areas sum to one. {len(recorded.positions):,} recorded and "
            f"{len(simulated.positions):,} simulated frames."
        ),
    )


def _places(inputs: ReportInputs) -> Iterator[Block]:
    """Where individuals are: maps of the recorded and of the simulated side."""
    prepared = Prepared(inputs.demos)
    adapt, sides = inputs.words.adapt, (prepared.recorded, factual_rollouts(inputs)[0])
    maps = [prepared.cell_shares(side).mean(axis=(0, 1)).reshape(CELLS, CELLS) for side in sides]
    most = float(max(one.max() for one in maps))
    yield Gallery(
        [
            to_image(
                figures.occupancy_map(one, name, most), adapt(f"Map of where they are: {name}")
            )
            for one, name in zip(maps, (adapt("recorded").capitalize(), "Simulated"))
        ],
        adapt(
            "Share of the time in each part of the rectangle that holds the recorded positions, "
            "all individuals and episodes; the same shade is the same share in both."
        ),
        strip=True,
    )


def _metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation, adapt = inputs.evaluation, inputs.words.adapt
    yield Text(
        adapt(
            "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
            "interval; the dashed line is the recorded mean. Intervals add the margin of "
            f"recordings (studentised bootstrap, {evaluation.resamples:,} resamples) and that "
            "of training seeds (Student's t); repetitions from one start are never counted as "
            "independent."
            + " Captures are episodes in which the target was reached."
            * inputs.demos.has_goal
        )
    )
    measured = set(evaluation.comparison["measure"])
    metrics = [metric for metric in METRICS if metric.caption and metric.key in measured]
    images = [image for metric in metrics for image in _metric_images(inputs, metric)]
    yield Gallery(images, adapt(" ".join(metric.caption for metric in metrics)))
    table = comparison_as_table(
        evaluation, inputs.words, list(countings(evaluation.comparison)), inputs.learner
    )
    yield replace(table, folded="All numbers of the comparison")


def _metric_images(inputs: ReportInputs, metric: Metric) -> Iterator[Image]:
    """All episodes and captures side by side; of a share a single panel of means."""
    words, comparison = inputs.words, inputs.evaluation.comparison
    names = [RECORDED, *inputs.rollouts] if metric.of_recordings else list(inputs.rollouts)
    rows = inputs.evaluation.metrics.query("factual")

    def mean(name: str, counting: str) -> Interval:
        row = pick(comparison, method=name, measure=metric.key, counting=counting)
        value = words.interval(row, metric)
        return scaled(value, 100.0) if metric.share else value

    for counting, title in countings(comparison).items():
        means = {name: mean(name, counting) for name in names}
        look: dict[str, Any] = {"limits": (-2.0, 102.0)}
        if not metric.share:
            counted = rows[rows["captured"]] if counting == "captures" else rows
            values = {
                name: words.factor(metric)
                * counted.loc[counted["method"] == name, metric.key].to_numpy()
                for name in names
            }
            if not any(map(len, values.values())):
                continue
            look = {"values": values}
        figure = figures.interval_rows(
            means,
            words.axis(metric),
            title=f"{metric.label}: {title}",
            label=words.label,
            reference=means[names[0]].estimate if metric.of_recordings else None,
            **look,
        )
        yield to_image(figure, f"{words.axis(metric)} by method, {title}")
        if metric.share:
            return


def countings(table: pd.DataFrame) -> dict[str, str]:
    """Return the rules of what counts that a table has rows of."""
    return {rule: title for rule, title in COUNTING.items() if (table["counting"] == rule).any()}
