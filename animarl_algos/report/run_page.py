"""The page of a run, or of several: sections of figures, tables and sentences, in order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.comparison import BASELINE, COUNTING, factual, find_method
from animarl_algos.evaluation.metrics import DTW, METRICS, Metric
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict import implausible
from animarl_algos.report import figures
from animarl_algos.report.counterfactual_page import error_table, shift_table
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.page import (
    Block,
    Gallery,
    Lead,
    Page,
    Section,
    Table,
    Text,
    tabulate,
    write_page,
)
from animarl_algos.report.path_figures import path_panels, value_map, values_along_path
from animarl_algos.report.player import examples, factual_rollouts, run_player
from animarl_algos.report.provenance import provenance, to_paste
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.verdict_section import verdict_blocks, verdict_lead
from animarl_algos.report.words import (
    MINUS,
    NOTHING,
    cautions,
    number,
    pick,
    scaled,
    with_interval,
)
from animarl_envs.fitting import IndividualFit
from animarl_envs.fitting.result import fits_by_kind

if TYPE_CHECKING:
    import pandas as pd

QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the DTW distance, for the examples
Column = Callable[[Any], str]


def run_page(inputs: ReportInputs) -> Page:
    """Return the page: the verdict and the player, then every section that has blocks."""
    demos = inputs.demos
    facts = [
        ("Species", demos.species),
        ("Evaluated on", f"{demos.num_episodes} demonstrations{_in_folds(inputs.folds)}"),
        ("Method", method_label(inputs.learner)),
        ("Training seeds", ", ".join(map(str, inputs.seeds)) or NOTHING),
    ]
    return Page(
        title=inputs.title,
        kind="Simulation report",
        synthetic=demos.synthetic,
        facts=facts + ([("Made", inputs.created)] if inputs.created else []),
        lead=_lead(inputs),
        player=run_player(inputs),
        sections=[
            Section(anchor, title, list(make(inputs)), FOLDED.get(anchor, ""))
            for anchor, title, make in SECTIONS
        ],
        methods=list(map(method_label, inputs.rollouts)),
    )


def _in_folds(folds: int) -> str:
    return f", cross-validated in {folds} folds" if folds else ""


def write_report(inputs: ReportInputs, out: str | Path) -> Path:
    """Write the report to ``out``, whole or not at all, and return the path."""
    return write_page(run_page(inputs), Path(out))


def _lead(inputs: ReportInputs) -> Lead:
    """The verdict, and what limits it."""
    evaluation, say = inputs.evaluation, inputs.words.say
    limits = cautions(evaluation.comparison, inputs.learner, inputs.demos.synthetic)
    doubtful = map(say, implausible(evaluation.verdict))
    said = dict.fromkeys([*doubtful, *inputs.warnings, *limits])
    return verdict_lead(evaluation.verdict, inputs.words, list(said))


def _verdict(inputs: ReportInputs) -> Iterator[Block]:
    return verdict_blocks(inputs.evaluation.verdict, inputs.words)


# -- what the simulation looks like ---------------------------------------------------------------


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
            what = words.say(f"Simulated and recorded paths of test demonstration {demo}")
            images.append(to_image(figure, f"{what}, {distance} {words.unit_of(DTW)}"))
        where = f" Condition: {condition}." if condition else ""
        yield Gallery(
            images,
            f"{method_label(inputs.learner)} above the demonstration that each rollout started "
            f"from.{where} Chosen by rank, not by eye: from left to right the rollouts nearest to "
            "the 10th, 30th, 50th, 70th and 90th percentile of the DTW distance to the "
            f"demonstration ({words.unit_of(DTW)}), no two from one start, so the first are among "
            "the best and the last among the worst. Open marks are starts, filled ones "
            f"ends{source}.",
            strip=True,
        )


def _speeds(inputs: ReportInputs) -> Iterator[Block]:
    simulated = factual_rollouts(inputs)[0].speeds()
    recorded = Rollouts.from_demonstrations(inputs.demos).speeds()
    roles, words = np.array(inputs.demos.roles), inputs.words
    images = []
    for role in dict.fromkeys(inputs.demos.roles):
        chosen = roles == role
        kind = role.capitalize() if inputs.demos.has_goal else "Animal"
        title = kind + ("s" if chosen.sum() > 1 else "")
        both = simulated[:, chosen].ravel(), recorded[:, chosen].ravel()
        figure = figures.speed_histogram(*both, words, title)
        alt = f"Histogram of speeds: {title}, simulated over recorded"
        images.append(to_image(figure, words.say(alt)))
    yield Gallery(
        images,
        words.say(
            "Speed of every step, recorded (filled) and simulated by "
            f"{method_label(inputs.learner)} (line), all episodes, on shared bins; areas sum to "
            f"one. {len(recorded):,} recorded and {len(simulated):,} simulated steps per "
            "individual."
        ),
    )


# -- metrics --------------------------------------------------------------------------------------


def _metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation, say = inputs.evaluation, inputs.words.say
    yield Text(
        say(
            "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
            "interval; the dashed line is the recorded mean. Intervals add the margin of "
            f"demonstrations (studentised bootstrap, {evaluation.resamples:,} resamples) and that "
            "of training seeds (Student's t); repetitions from one start are never counted as "
            "independent."
            + " Captures are episodes in which the target was reached."
            * inputs.demos.has_goal
        )
    )
    measured = set(evaluation.comparison["metric"])
    for metric in (m for m in METRICS if m.caption and m.key in measured):
        yield Text.heading(metric.label)
        yield Gallery(list(_metric_images(inputs, metric)), say(metric.caption))
        yield _metric_table(inputs, metric)


def _metric_images(inputs: ReportInputs, metric: Metric) -> Iterator[Image]:
    """All episodes and captures side by side; of a share a single panel of means."""
    words, comparison = inputs.words, inputs.evaluation.comparison
    names = [RECORDED, *inputs.rollouts] if metric.of_recordings else list(inputs.rollouts)
    rows = factual(inputs.evaluation.metrics)

    def mean(name: str, counting: str) -> Interval:
        row = pick(comparison, method=name, metric=metric.key, counting=counting)
        value = words.interval(row, "mean", metric)
        return scaled(value, 100.0) if metric.share else value

    for counting, title in countings(comparison).items():
        means = {name: mean(name, counting) for name in names}
        alt = f"{words.axis(metric) if metric.share else metric.label} by method, {title}"
        look: Any = {"title": title.capitalize(), "label": words.label}
        if metric.share:
            figure = figures.interval_rows(
                means, words.axis(metric), reference=means[RECORDED].estimate,
                limits=(-2.0, 102.0), **look,
            )  # fmt: skip
            yield to_image(figure, alt)
            return
        counted = rows[rows["captured"]] if counting == "captures" else rows
        values = {
            name: words.factor(metric)
            * counted.loc[counted["method"] == name, metric.key].to_numpy()
            for name in names
        }
        if any(len(v) for v in values.values()):
            figure = figures.metric_distribution(values, means, words.axis(metric), **look)
            yield to_image(figure, alt)


def _metric_table(inputs: ReportInputs, metric: Metric) -> Table:
    comparison, words = inputs.evaluation.comparison, inputs.words
    rows = comparison[comparison["metric"] == metric.key]
    baseline = find_method(inputs.rollouts, BASELINE)

    def told(key: str) -> Column:
        return lambda row: words.told(row, key, metric)

    def minus(second: str) -> Column:
        return lambda row: words.told(
            pick(
                inputs.evaluation.pairs, first=row["method"], second=second, metric=metric.key,
                counting=row["counting"],
            ),
            "difference",
            metric,
        )  # fmt: skip

    columns: dict[str, Column] = {
        "Method": lambda row: words.label(str(row["method"])),
        "Episodes": lambda row: str(int(row["rollouts"])),
        "Starts": lambda row: str(int(row["demos"])),
        f"Mean\n({words.unit_of(metric)})": told("mean"),
        "Interval of": lambda row: str(row["covers"]),
    }
    if rows["to_recorded"].notna().any():
        columns[words.say("Minus recorded")] = told("to_recorded")
    if baseline is not None:
        columns[f"Minus {BASELINE}"] = minus(baseline)
    note = ""
    if not metric.of_recordings:
        # A distance to the recordings stands beside duration and outcome: an episode that ends at
        # once would pass for a close one.
        reaches = rows["reached"].notna().any()
        columns |= {
            "Duration\n(s)": lambda row: number(row["duration"]),
            **({"Reached\n(%)": lambda row: number(100.0 * row["reached"])} if reaches else {}),
            "Within starts": told("within"),
            f"Minus {method_label(inputs.learner)}": minus(inputs.learner),
        }
        note = (
            " Within starts: the mean with what all methods share of a start taken out "
            "(Cousineau 2005, Morey 2008), to compare methods where episodes differ much in length."
        )
        if (per_step := metric.per_step) is not None:
            columns["Per step"] = lambda row: words.told(
                pick(
                    comparison, method=row["method"], metric=per_step.key, counting=row["counting"]
                ),
                "mean",
                per_step,
            )
            note += " Per step: the mean distance of aligned positions."
    groups = [
        ("" if metric.share else title.capitalize(), _rows(rows[rows["counting"] == counting]))
        for counting, title in countings(rows).items()
    ]
    return tabulate(
        f"{metric.label} by method",
        columns,
        groups,
        f"Mean [95 % interval] and paired differences.{note}",
        strong=lambda row: row["method"] == inputs.learner,
        folded=f"{metric.label} by method",
    )


def countings(table: pd.DataFrame) -> dict[str, str]:
    """Return the rules of what counts that a table has rows of."""
    return {rule: title for rule, title in COUNTING.items() if (table["counting"] == rule).any()}


def _rows(table: pd.DataFrame) -> list[Any]:
    return [row for _, row in table.iterrows()]


def _contrasts(inputs: ReportInputs) -> Iterator[Block]:
    contrasts, words = inputs.evaluation.contrasts, inputs.words
    if contrasts.empty:
        return
    metrics = {metric.key: metric for metric in METRICS}

    def title(gate: Any) -> str:
        metric = metrics[gate["metric"]]
        said = f"{metric.label}: gate {gate['gate']} ({gate['measure']}"
        if math.isfinite(gate["gate_p"]):
            said += (
                f"; F = {number(gate['gate_f'])}, p = {number(gate['gate_p'], 2)}, exchanging "
                f"{gate['gate_unit']}; differences in {words.unit_of(metric)}"
            )
        return f"{said})"

    def difference(row: Any) -> str:
        if not row["gate_passed"]:
            return NOTHING
        return with_interval(words.interval(row, "difference", metrics[row["metric"]]))

    yield tabulate(
        "Planned contrasts",
        {
            "Contrast": lambda row: (
                f"{method_label(row['first'])} {MINUS} {method_label(row['second'])}"
            ),
            words.say("Difference of the gaps to the recordings"): difference,
        },
        [
            (title(rows.iloc[0]), _rows(rows))
            for _, rows in contrasts.groupby(["metric", "measure"], sort=False)
        ],
        words.say(
            "The contrasts planned in advance, all episodes, of the starts that all methods have. "
            "Compared is the energy score per start and, as in the paper, the absolute gap between "
            "its mean and the recording (for DTW the distance itself); below zero, the first "
            "method is closer. A contrast is shown only behind a gate that was passed."
        ),
        faint=lambda row: not row["gate_passed"],
    )


def _counterfactual(inputs: ReportInputs) -> Iterator[Block]:
    table = inputs.evaluation.counterfactual
    if table.empty:
        return
    yield Text(
        "The policy is told the other condition; the world stays as it is. Shifts are those of the "
        "path length, on the same starts and the same networks. The page of 'animarl "
        "counterfactual' shows them beside networks that learned nothing."
    )
    yield shift_table(inputs, table)
    yield replace(error_table(inputs, table), folded="Errors to the demonstrations")


# -- the model behind it --------------------------------------------------------------------------


def _locomotion(inputs: ReportInputs) -> Iterator[Block]:
    fit, words = inputs.fit, inputs.words
    if fit is None:
        return
    unit = words.unit

    def length(key: str, digits: int = 3) -> Column:
        return lambda one: number(unit.per_arena_unit * getattr(one, key), digits)

    def braking(one: IndividualFit) -> str:
        """With the interval that follows from that of d, with which it only falls."""
        low, high = one.damping_interval or (math.nan, math.nan)
        short, long = (fit.dt / -math.log1p(-d) if 0 < d < 1 else math.nan for d in (high, low))
        return with_interval(Interval(one.braking_time, short, long))

    columns: dict[str, Column] = {
        "Individual": lambda one: str(one.name),
        "Damping d\n(per step)": lambda one: _fitted(one.damping, one.damping_interval),
        f"Thrust u\n({unit.name}/s\u00b2)": (
            lambda one: _fitted(one.thrust, one.thrust_interval, unit.per_arena_unit)
        ),
        f"Velocity\nRMSE ({words.speed})": length("velocity_rmse", 2),
        f"Terminal\nspeed ({words.speed})": length("terminal_speed"),
        words.say(f"Recorded top\nspeed ({words.speed})"): length("top_speed"),
        "Braking\ntime (s)": braking,
    }
    if any(one.onsets is not None for one in fit.individuals):
        columns["Onsets"] = lambda one: str(one.onsets)
    yield tabulate(
        "Fitted locomotion",
        columns,
        [("", fits_by_kind(fit, inputs.demos))],
        f"v\u2032 = (1 {MINUS} d) v + u a \u0394t, \u0394t = {fit.dt:g} s, {fit.method} "
        f"fit on {fit.episodes} episodes ({fit.fitted_on}); 95 % intervals over {fit.bootstrap:,} "
        f"resamples of episodes; velocity RMSE on {fit.validation_episodes} episodes "
        f"({fit.validated_on}). Terminal speed u \u0394t / d is where constant thrust leads; the "
        f"{inputs.recorded} top speed is the median above the 99th percentile; after the "
        "braking time a coasting animal has lost all but 1/e of its speed.",
    )


def _fitted(value: float, ends: tuple[float, float] | None, factor: float = 1.0) -> str:
    low, high = ends or (math.nan, math.nan)
    return with_interval(scaled(Interval(value, low, high), factor))


def _decisions(inputs: ReportInputs) -> Iterator[Block]:
    decisions, dt = inputs.decisions, inputs.demos.dt
    if decisions is None:
        return
    who, has_map = decisions.individual, bool(decisions.map_q.size)
    is_target = inputs.demos.roles[inputs.demos.individuals.index(who)] == "target"
    others = "the others" if is_target else "the others (the target a cross)"
    along = values_along_path(decisions, dt)
    images = [to_image(along, f"Action values of {who} along test demonstration {decisions.demo}")]
    over = ""
    if has_map:
        figure = value_map(decisions, inputs.stage, dt)
        images.append(to_image(figure, f"Best action value of {who} over the arena"))
        over = (
            " Over the arena: the value of the best action and the acceleration it calls for, were "
            f"the animal put there at rest halfway through that episode, its memory and {others} "
            "as they then were."
        )
    yield Gallery(
        images,
        f"What {method_label(inputs.learner)} values for {who} along test "
        f"demonstration {decisions.demo}, the one of median length, everyone moving as there. "
        "Above, the state value (mean of Q over actions) and the best action's; below, the "
        "advantage of each direction of acceleration, angles taken from the direction to the "
        f"learner; dots: the action found in the demonstration.{over}",
    )


def _learning(inputs: ReportInputs) -> Iterator[Block]:
    curves = inputs.learning_curves
    if curves is None or curves.empty:
        return
    for phase, rows in curves.groupby("phase", sort=False):
        label = "Epoch" if phase == "offline" else "Environment steps"
        yield Text.heading(f"{phase} phase".capitalize())
        yield Gallery(
            [
                to_image(figures.learning_curve(own, title, label), f"{title} over training")
                for title, own in figures.chosen_curves(rows, inputs.learner).items()
            ],
            "One thin line per training seed, thick their mean; a single seed is drawn thick. "
            f"Lines by individual are losses of {method_label(inputs.learner)}.",
        )


# -- where it comes from --------------------------------------------------------------------------


def _paste(inputs: ReportInputs) -> Iterator[Block]:
    evaluation, words = inputs.evaluation, inputs.words
    verdict, seeds = evaluation.verdict, len(inputs.seeds)
    splits = ", ".join(f"{count} {split}" for split, count in inputs.episodes.items())
    fitted = (
        "Each individual moved by a fitted first-order model of locomotion "
        f"(damping and thrust, {inputs.fit.method} fit on {inputs.fit.episodes} episodes)."
        if inputs.fit is not None
        else ""
    )
    trained = f" ({seeds} training seed{'s' if seeds != 1 else ''})" if seeds else ""
    sentences: Iterable[str] = (
        fitted,
        f"Its actions were chosen by a policy trained with {method_label(inputs.learner)}"
        f"{trained}.",
        f"From {verdict.starts} test starts, {verdict.rollouts} episodes were simulated and "
        f"compared with the {words.say('recordings')} of the same starts: endings, duration, path "
        "length, speed and turning by their differences (95 % intervals over demonstrations, by "
        f"a studentised bootstrap with {evaluation.resamples:,} resamples, and over training "
        "seeds, by Student's t) and by the Wasserstein "
        f"distance against exchanged {words.say('recordings')}, and windows of motion by a "
        "cross-fitted two-sample classifier (Lopez-Paz and Oquab 2017).",
    )
    return to_paste(
        inputs, f"; episodes: {splits}" if splits else "", list(filter(None, sentences))
    )


def _provenance(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    return provenance(
        inputs,
        "run",
        [(f"{split} episodes", str(count)) for split, count in inputs.episodes.items()],
        [
            ("resamples of means and differences", f"{evaluation.resamples:,}"),
            ("resamples of distances", f"{evaluation.distance_resamples:,}"),
            ("seed of the resampling", str(evaluation.seed)),
            ("training seeds", ", ".join(map(str, inputs.seeds)) or "not given"),
        ],
    )


SECTIONS: tuple[tuple[str, str, Callable[[ReportInputs], Iterator[Block]]], ...] = (
    ("verdict", "Verdict", _verdict),
    ("trajectories", "Trajectories", _trajectories),
    ("speeds", "Speeds", _speeds),
    ("metrics", "Metrics", _metrics),
    ("contrasts", "Planned contrasts", _contrasts),
    ("counterfactual", "Counterfactual", _counterfactual),
    ("locomotion", "Locomotion", _locomotion),
    ("decisions", "Decisions", _decisions),
    ("learning", "Learning", _learning),
    ("paste", "To paste", _paste),
    ("provenance", "How this was made", _provenance),
)
"""Anchor and title of every section, and what yields its blocks."""
FOLDED = {
    "contrasts": "Gates and differences",
    "learning": "Learning curves",
    "paste": "A paragraph and what to cite",
    "provenance": "Command, settings, machine, versions",
}
"""What a reader clicks to see a section."""
