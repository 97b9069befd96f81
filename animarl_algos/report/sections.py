"""The sections of a report, in order, and what each holds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import findings, panels
from animarl_algos.report import sentences as wording
from animarl_algos.report.blocks import (
    Block,
    Command,
    Gallery,
    Group,
    Heading,
    Pairs,
    Row,
    Section,
    Summary,
    Table,
    Text,
)
from animarl_algos.report.distance_section import distances
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.sentences import NOTHING, number, with_interval
from animarl_algos.report.style import method_label
from animarl_algos.report.verdict_section import verdict_blocks, verdict_sentence
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


def summary(inputs: ReportInputs) -> Summary:
    """The sentences at the top, worked out from the tables."""
    comparison = inputs.evaluation.comparison
    return Summary(
        [
            verdict_sentence(inputs.evaluation.verdict),
            *wording.headline(comparison, inputs.evaluation.pairs, inputs.learner),
        ],
        wording.cautions(comparison, inputs.learner, inputs.demos.synthetic),
    )


def build_sections(inputs: ReportInputs) -> list[Section]:
    """All sections that have something to show, in order."""
    demonstrated = "Demonstrated" if inputs.demos.synthetic else "Recorded"
    verdict = verdict_blocks(inputs.evaluation.verdict, demonstrated)
    candidates = [
        Section("verdict", "Verdict", list(verdict)),
        Section("trajectories", "Trajectories", list(_trajectories(inputs))),
        Section("speeds", "Speeds", list(_speeds(inputs))),
        Section("metrics", "Metrics", list(findings.metrics(inputs))),
        Section("distances", "Distance to the recordings", list(distances(inputs))),
        Section("contrasts", "Planned contrasts", list(findings.contrasts(inputs))),
        Section("counterfactual", "Counterfactual", list(findings.counterfactual(inputs))),
        Section("locomotion", "Locomotion", list(_locomotion(inputs))),
        Section("decisions", "Decisions", list(_decisions(inputs))),
        Section("learning", "Learning", list(_learning(inputs))),
        Section("provenance", "How this was made", list(_provenance(inputs))),
    ]
    return [section for section in candidates if section.blocks]


# -- what the simulation looks like ---------------------------------------------------------------


def _trajectories(inputs: ReportInputs) -> Iterator[Block]:
    learner = method_label(inputs.learner)
    for condition, images in panels.trajectories(inputs):
        where = f" Condition: {condition}." if condition else ""
        marks = "target black"
        if "searcher" in inputs.demos.roles:
            marks = "cross: the source; bar: arena units; paths that leave the window are cut"
        yield Gallery(
            images,
            f"{learner} above the demonstration that each rollout started from.{where} Chosen by "
            "rank, not by eye: from left to right the rollouts nearest to the 10th, 30th, 50th, "
            "70th and 90th percentile of the DTW distance to the demonstration (arena units), so "
            "the first are among the best and the last among the worst. Open circles mark starts, "
            f"filled ones ends; {marks}.",
            strip=True,
        )


def _speeds(inputs: ReportInputs) -> Iterator[Block]:
    images, steps = panels.speeds(inputs)
    yield Gallery(
        images,
        f"Speed of every step, recorded (dark) and simulated by {method_label(inputs.learner)} "
        f"(light), all episodes, on shared bins; areas sum to one. {steps[1]:,} recorded and "
        f"{steps[0]:,} simulated steps per individual.",
    )


# -- where it comes from --------------------------------------------------------------------------


def _locomotion(inputs: ReportInputs) -> Iterator[Block]:
    fit = inputs.fit
    if fit is None:
        return
    onsets = any(one.onsets is not None for one in fit.individuals)
    lines = []
    for one in fit.individuals:
        cells = [
            one.name,
            with_interval(_interval(one.damping, one.damping_interval)),
            with_interval(_interval(one.thrust, one.thrust_interval)),
            number(one.velocity_rmse, 2),
            number(one.terminal_speed),
            number(one.top_speed),
            with_interval(_braking(one, fit.dt)),
        ]
        lines.append(Row(cells + ([str(one.onsets)] if onsets else [])))
    columns = [
        "Individual", "Damping d", "Thrust u", "Velocity\nRMSE", "Terminal\nspeed",
        "Recorded\ntop speed", "Braking\ntime (s)",
    ]  # fmt: skip
    yield Table(
        "Fitted locomotion",
        columns + (["Onsets"] if onsets else []),
        [Group("", lines)],
        f"v\u2032 = (1 {wording.MINUS} d) v + u a \u0394t, \u0394t = {fit.dt:g} s, {fit.method} "
        f"fit on {fit.episodes} episodes ({fit.fitted_on}); 95 % intervals over {fit.bootstrap:,} "
        f"resamples of episodes; velocity RMSE on {fit.validation_episodes} episodes "
        f"({fit.validated_on}). Terminal speed u \u0394t / d is where constant thrust leads; the "
        "recorded top speed is the median above the 99th percentile; after the braking time a "
        "coasting animal has lost all but 1/e of its speed. Lengths in arena units, times in s, "
        "d per step.",
    )


def _decisions(inputs: ReportInputs) -> Iterator[Block]:
    decisions = inputs.decisions
    if decisions is None:
        return
    target = panels.is_target(inputs, decisions.individual)
    others = "the others" if target else "the others (the target dark)"
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
        f"demonstration {decisions.demo}, the one of median length, everyone moving as recorded. "
        "Above, the state value (mean of Q over actions) and the best action's; below, the "
        "advantage of each direction of acceleration, angles taken from the direction to the "
        f"learner; dots: the action found in the recording.{over}",
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


def _provenance(inputs: ReportInputs) -> Iterator[Block]:
    demos = inputs.demos
    if inputs.command:
        yield Text("To repeat this run:")
        yield Command(inputs.command)
    entries = [
        ("fingerprint of the evaluated set", inputs.evaluation.fingerprint),
        ("evaluated episodes", str(demos.num_episodes)),
        ("individuals", ", ".join(demos.individuals)),
        ("time step", f"{demos.dt:g} s"),
        *((f"{split} episodes", str(count)) for split, count in inputs.episodes.items()),
        *flattened(demos.provenance),
    ]
    yield Pairs("Demonstrations", entries)
    yield Pairs(
        "Statistics",
        [
            ("resamples of means and differences", f"{inputs.evaluation.resamples:,}"),
            ("resamples of distances", f"{inputs.evaluation.distance_resamples:,}"),
            ("seed of the resampling", str(inputs.evaluation.seed)),
            ("training seeds", ", ".join(map(str, inputs.seeds)) or NOTHING),
        ],
    )
    if inputs.settings:
        yield Pairs("Settings", flattened(inputs.settings))
    if inputs.versions:
        yield Pairs("Versions", list(inputs.versions.items()))


def flattened(settings: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested settings as dotted names and printable values."""
    out: list[tuple[str, str]] = []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            out += flattened(value, f"{prefix}{key}.")
        elif isinstance(value, list | tuple):
            out.append((f"{prefix}{key}", ", ".join(map(str, value)) or NOTHING))
        else:
            out.append((f"{prefix}{key}", {True: "yes", False: "no"}[value]
                        if isinstance(value, bool) else str(value)))  # fmt: skip
    return out


def _braking(one: IndividualFit, dt: float) -> Interval:
    """Braking time with the interval that follows from that of d, with which it only falls."""
    low, high = (math.nan, math.nan) if one.damping_interval is None else one.damping_interval
    ends = [dt / -math.log1p(-d) if 0 < d < 1 else math.nan for d in (high, low)]
    return Interval(one.braking_time, *ends)


def _interval(value: float, ends: tuple[float, float] | None) -> Interval:
    low, high = (float("nan"), float("nan")) if ends is None else ends
    return Interval(value, low, high)
