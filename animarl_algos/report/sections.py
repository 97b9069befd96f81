"""The sections of a report, in order, and what each holds."""

from __future__ import annotations

import math
from collections.abc import Iterator

from animarl_algos.evaluation.metrics import DTW
from animarl_algos.evaluation.plausibility import implausible
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import findings, panels
from animarl_algos.report import sentences as wording
from animarl_algos.report.blocks import (
    Block,
    Gallery,
    Group,
    Heading,
    Row,
    Section,
    Table,
)
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.provenance import provenance, to_paste
from animarl_algos.report.sentences import NOTHING, number, with_interval
from animarl_algos.report.style import method_label
from animarl_algos.report.verdict_section import Lead, verdict_blocks, verdict_lead
from animarl_algos.report.words import scaled
from animarl_envs.fitting import IndividualFit


def facts(inputs: ReportInputs) -> list[tuple[str, str]]:
    """The line under the title."""
    demos = inputs.demos
    rows = [
        ("Species", demos.species),
        ("Evaluated on", f"{demos.num_episodes} demonstrations"),
        ("Method", method_label(inputs.learner)),
        ("Training seeds", ", ".join(map(str, inputs.seeds)) or NOTHING),
    ]
    return rows + ([("Made", inputs.created)] if inputs.created else [])


def lead(inputs: ReportInputs) -> Lead:
    """The verdict, and what limits it."""
    comparison, words = inputs.evaluation.comparison, inputs.words
    limits = wording.cautions(comparison, inputs.learner, inputs.demos.synthetic)
    doubtful = [words.say(sentence) for sentence in implausible(inputs.evaluation.verdict)]
    cautions = dict.fromkeys([*doubtful, *inputs.warnings, *limits])
    return verdict_lead(inputs.evaluation.verdict, words, list(cautions))


def build_sections(inputs: ReportInputs) -> list[Section]:
    """All sections that have something to show, in order."""
    words = inputs.words
    candidates = [
        Section("verdict", "Verdict", list(verdict_blocks(inputs.evaluation.verdict, words))),
        Section("trajectories", "Trajectories", list(_trajectories(inputs))),
        Section("speeds", "Speeds", list(_speeds(inputs))),
        Section("metrics", "Metrics", list(findings.metrics(inputs))),
        Section("contrasts", "Planned contrasts", list(findings.contrasts(inputs))),
        Section("counterfactual", "Counterfactual", list(findings.counterfactual(inputs))),
        Section("locomotion", "Locomotion", list(_locomotion(inputs))),
        Section("decisions", "Decisions", list(_decisions(inputs))),
        Section("learning", "Learning", list(_learning(inputs))),
        Section("paste", "To paste", list(to_paste(inputs))),
        Section("provenance", "How this was made", list(provenance(inputs))),
    ]
    return [section for section in candidates if section.blocks]


# -- what the simulation looks like ---------------------------------------------------------------


def _trajectories(inputs: ReportInputs) -> Iterator[Block]:
    learner, words = method_label(inputs.learner), inputs.words
    for condition, images in panels.trajectories(inputs):
        where = f" Condition: {condition}." if condition else ""
        source = (
            "; the cross is the source, and paths that leave the window are cut"
            if "searcher" in inputs.demos.roles
            else ""
        )
        yield Gallery(
            images,
            f"{learner} above the demonstration that each rollout started from.{where} Chosen by "
            "rank, not by eye: from left to right the rollouts nearest to the 10th, 30th, 50th, "
            "70th and 90th percentile of the DTW distance to the demonstration "
            f"({words.unit_of(DTW)}), no two from one start, so the first are among the best and "
            f"the last among the worst. Open marks are starts, filled ones ends{source}.",
            strip=True,
        )


def _speeds(inputs: ReportInputs) -> Iterator[Block]:
    images, steps = panels.speeds(inputs)
    yield Gallery(
        images,
        inputs.words.say(
            f"Speed of every step, recorded (filled) and simulated by "
            f"{method_label(inputs.learner)} (line), all episodes, on shared bins; areas sum to "
            f"one. {steps[1]:,} recorded and {steps[0]:,} simulated steps per individual."
        ),
    )


# -- where it comes from --------------------------------------------------------------------------


def _locomotion(inputs: ReportInputs) -> Iterator[Block]:
    fit, words = inputs.fit, inputs.words
    if fit is None:
        return
    unit = words.unit
    onsets = any(one.onsets is not None for one in fit.individuals)
    lines = []
    for one in fit.individuals:
        cells = [
            one.name,
            with_interval(_interval(one.damping, one.damping_interval)),
            with_interval(scaled(_interval(one.thrust, one.thrust_interval), unit.per_arena_unit)),
            number(unit.per_arena_unit * one.velocity_rmse, 2),
            number(unit.per_arena_unit * one.terminal_speed),
            number(unit.per_arena_unit * one.top_speed),
            with_interval(_braking(one, fit.dt)),
        ]
        lines.append(Row(cells + ([str(one.onsets)] if onsets else [])))
    columns = [
        "Individual",
        "Damping d\n(per step)",
        f"Thrust u\n({unit.name}/s\u00b2)",
        f"Velocity\nRMSE ({words.speed})",
        f"Terminal\nspeed ({words.speed})",
        words.say(f"Recorded top\nspeed ({words.speed})"),
        "Braking\ntime (s)",
    ]
    yield Table(
        "Fitted locomotion",
        columns + (["Onsets"] if onsets else []),
        [Group("", lines)],
        f"v\u2032 = (1 {wording.MINUS} d) v + u a \u0394t, \u0394t = {fit.dt:g} s, {fit.method} "
        f"fit on {fit.episodes} episodes ({fit.fitted_on}); 95 % intervals over {fit.bootstrap:,} "
        f"resamples of episodes; velocity RMSE on {fit.validation_episodes} episodes "
        f"({fit.validated_on}). Terminal speed u \u0394t / d is where constant thrust leads; the "
        f"{words.say('recorded')} top speed is the median above the 99th percentile; after the "
        "braking time a coasting animal has lost all but 1/e of its speed.",
    )


def _decisions(inputs: ReportInputs) -> Iterator[Block]:
    decisions = inputs.decisions
    if decisions is None:
        return
    target = panels.is_target(inputs, decisions.individual)
    others = "the others" if target else "the others (the target a cross)"
    over = (
        " Over the arena: the value of the best action and the acceleration it calls for, were the "
        f"animal put there at rest halfway through that episode, its memory and {others} as they "
        "then were."
        if decisions.map_q.size
        else ""
    )
    yield Gallery(
        panels.decision_panels(inputs, decisions),
        f"What {method_label(inputs.learner)} values for {decisions.individual} along test "
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
        yield Heading(f"{phase} phase".capitalize())
        yield Gallery(
            panels.learning_panels(rows, inputs.learner, offline=phase == "offline"),
            "One thin line per training seed, thick their mean; a single seed is drawn thick. "
            f"Lines by individual are losses of {method_label(inputs.learner)}.",
        )


def _braking(one: IndividualFit, dt: float) -> Interval:
    """Braking time with the interval that follows from that of d, with which it only falls."""
    low, high = (math.nan, math.nan) if one.damping_interval is None else one.damping_interval
    short, long = (dt / -math.log1p(-d) if 0 < d < 1 else math.nan for d in (high, low))
    return Interval(one.braking_time, short, long)


def _interval(value: float, ends: tuple[float, float] | None) -> Interval:
    low, high = (float("nan"), float("nan")) if ends is None else ends
    return Interval(value, low, high)
