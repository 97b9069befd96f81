"""What the sections of a report hold: texts, rows of figures, tables, lists of settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from animarl_algos.evaluation import panels, wording
from animarl_algos.evaluation.comparison import COUNTING, interval
from animarl_algos.evaluation.counterfactual import DIFFERENCE, ERROR, SHIFT, WORLD_SHIFT
from animarl_algos.evaluation.metrics import DTW, DURATION, METRICS, PATH_LENGTH, RETURN, Metric
from animarl_algos.evaluation.report import ReportInputs
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.style import Image, method_label
from animarl_algos.evaluation.wording import NOTHING, comparison_row, number, with_interval
from animarl_envs.fitting import IndividualFit


@dataclass(frozen=True)
class Text:
    kind: ClassVar[str] = "text"
    text: str


@dataclass(frozen=True)
class Heading:
    kind: ClassVar[str] = "heading"
    text: str


@dataclass(frozen=True)
class Command:
    kind: ClassVar[str] = "command"
    text: str


@dataclass(frozen=True)
class Gallery:
    kind: ClassVar[str] = "gallery"
    images: Sequence[Image]
    caption: str
    strip: bool = False  # small pictures that stay side by side on a narrow page


class Row(NamedTuple):
    cells: Sequence[str]
    strong: bool = False
    faint: bool = False


class Group(NamedTuple):
    title: str
    rows: Sequence[Row]


@dataclass(frozen=True)
class Table:
    kind: ClassVar[str] = "table"
    label: str
    columns: Sequence[str]
    groups: Sequence[Group]
    caption: str
    left: int = 1  # so many leading columns hold words


@dataclass(frozen=True)
class Pairs:
    kind: ClassVar[str] = "pairs"
    title: str
    entries: Sequence[tuple[str, str]]


Block = Text | Heading | Command | Gallery | Table | Pairs


@dataclass(frozen=True)
class Section:
    anchor: str
    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Summary:
    findings: Sequence[str]
    cautions: Sequence[str]


def facts(inputs: ReportInputs) -> list[tuple[str, str]]:
    """The line under the title."""
    demos = inputs.demos
    rows = [
        ("Species", demos.species),
        ("Evaluated on", f"{demos.num_episodes} demonstrations"),
        ("Method", method_label(inputs.focus)),
        ("Training seeds", ", ".join(map(str, inputs.seeds)) or NOTHING),
    ]
    return rows + ([("Made", inputs.created)] if inputs.created else [])


def summary(inputs: ReportInputs) -> Summary:
    """The sentences at the top, worked out from the tables."""
    comparison = inputs.evaluation.comparison
    return Summary(
        wording.headline(comparison, inputs.focus),
        wording.cautions(comparison, inputs.focus, inputs.demos.synthetic),
    )


def build_sections(inputs: ReportInputs) -> list[Section]:
    """All sections that have something to show, in order."""
    candidates = [
        Section("trajectories", "Trajectories", list(_trajectories(inputs))),
        Section("speeds", "Speeds", list(_speeds(inputs))),
        Section("metrics", "Metrics", list(_metrics(inputs))),
        Section("distances", "Distance to the recordings", list(_distances(inputs))),
        Section("contrasts", "Planned contrasts", list(_contrasts(inputs))),
        Section("counterfactual", "Counterfactual", list(_counterfactual(inputs))),
        Section("locomotion", "Locomotion", list(_locomotion(inputs))),
        Section("learning", "Learning", list(_learning(inputs))),
        Section("provenance", "How this was made", list(_provenance(inputs))),
    ]
    return [section for section in candidates if section.blocks]


# -- what the simulation looks like ---------------------------------------------------------------


def _trajectories(inputs: ReportInputs) -> Iterator[Block]:
    focus = method_label(inputs.focus)
    for condition, images in panels.trajectories(inputs):
        where = f" Condition: {condition}." if condition else ""
        marks = "target black"
        if "searcher" in inputs.demos.roles:
            marks = "cross: the source; bar: arena units; paths that leave the window are cut"
        yield Gallery(
            images,
            f"{focus} above the demonstration that each rollout started from.{where} Chosen by "
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
        f"Speed of every step, recorded (dark) and simulated by {method_label(inputs.focus)} "
        f"(light), all episodes, on shared bins; areas sum to one. {steps[1]:,} recorded and "
        f"{steps[0]:,} simulated steps per individual.",
    )


# -- the numbers ----------------------------------------------------------------------------------


def _metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    yield Text(
        "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
        "interval; the dashed line is the recorded mean. Intervals are percentile bootstrap "
        f"intervals from {evaluation.resamples:,} paired resamples of demonstrations and of "
        "training seeds; repetitions from one start are never counted as independent. Captures "
        "are episodes in which the target was reached."
    )
    for metric in (RETURN, PATH_LENGTH, DURATION, DTW):
        yield Heading(metric.label)
        yield Gallery(panels.metric_panels(inputs, metric), _metric_caption(metric))
        yield _metric_table(inputs, metric)


def _metric_caption(metric: Metric) -> str:
    what = {
        RETURN.key: "Share of episodes in which a pursuer reached the target (the moth the "
        "source), all episodes.",
        PATH_LENGTH.key: "Path length per episode, mean over the pursuers (or the moth's): all "
        "episodes, and captures only.",
        DURATION.key: "Duration per episode: all episodes, and captures only.",
        DTW.key: "DTW distance of each rollout to the demonstration that it started from, mean "
        "over the pursuers (or the moth's), summed along the warping path: all episodes, and "
        "captures only.",
    }
    return what[metric.key]


def _metric_table(inputs: ReportInputs, metric: Metric) -> Table:
    comparison = inputs.evaluation.comparison
    rows = comparison[comparison["metric"] == metric.key]
    percent = metric is RETURN
    with_recorded = bool(rows["to_recorded"].notna().any())
    with_baseline = bool(rows["to_baseline"].notna().any())
    groups = []
    for counting in COUNTING:
        chosen = rows[rows["counting"] == counting]
        if chosen.empty:
            continue
        lines = []
        for _, row in chosen.iterrows():
            cells = [
                method_label(str(row["method"])),
                str(int(row["rollouts"])),
                str(int(row["demos"])),
                with_interval(interval(row, "mean"), percent),
            ]
            if with_recorded:
                cells.append(with_interval(interval(row, "to_recorded"), percent))
            if with_baseline:
                cells.append(with_interval(interval(row, "to_baseline"), percent))
            if metric is DTW:
                step = comparison_row(
                    comparison, str(row["method"]), METRICS[-1], str(row["counting"])
                )
                cells.append(NOTHING if step is None else with_interval(interval(step, "mean")))
            lines.append(Row(cells, strong=row["method"] == inputs.focus))
        groups.append(Group(COUNTING[counting].capitalize() if metric is not RETURN else "", lines))
    columns = ["Method", "Episodes", "Starts", f"Mean\n({'%' if percent else metric.unit})"]
    columns += ["Minus recorded"] if with_recorded else []
    columns += ["Minus BC"] if with_baseline else []
    columns += ["Per step"] if metric is DTW else []
    step_note = (
        " Per step: the distance over the frames of the longer of the two paths."
        if metric is DTW
        else ""
    )
    return Table(
        f"{metric.label} by method",
        columns,
        groups,
        f"Mean [95 % interval] and paired differences.{step_note}",
    )


def _distances(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    images = panels.distance_panels(inputs)
    if not images:
        return
    yield Gallery(
        images,
        "Kernel-density distance between simulated and recorded values (0: equal, 2: disjoint), "
        "all episodes, with its 95 % interval. Grey: what recordings against recordings give at "
        "the same sample sizes, central 95 % and mean. A value inside the grey cannot be told "
        "from chance; the distance is biased upwards, and so is its interval.",
    )
    groups = []
    for metric in (PATH_LENGTH, DURATION):
        for counting in COUNTING:
            lines = []
            for name in inputs.rollouts:
                row = comparison_row(evaluation.comparison, name, metric, counting)
                if row is None:
                    continue
                cells = [
                    method_label(name),
                    str(int(row["rollouts"])),
                    with_interval(interval(row, "kde")),
                    with_interval(interval(row, "kde_null")),
                    with_interval(interval(row, "wasserstein")),
                    with_interval(interval(row, "wasserstein_null")),
                ]
                lines.append(Row(cells, strong=name == inputs.focus))
            title = f"{metric.label} ({metric.unit}), {COUNTING[counting]}"
            groups.append(Group(title, lines))
    yield Table(
        "Distances to the recordings",
        [
            "Method",
            "Episodes",
            "Kernel-density\ndistance",
            "null\nreference",
            "Wasserstein\ndistance",
            "null\nreference",
        ],
        groups,
        "Both distances [95 % interval], each beside its null reference [central 95 %] from "
        f"{evaluation.distance_resamples:,} resamples. The kernel-density distance lies between 0 "
        "and 2; the Wasserstein distance has the metric's unit. Its null samples are independent, "
        "where rollouts from one start are not.",
    )


def _contrasts(inputs: ReportInputs) -> Iterator[Block]:
    contrasts = inputs.evaluation.contrasts
    if contrasts.empty:
        return
    groups = []
    for key, rows in contrasts.groupby("metric", sort=False):
        metric = next(m for m in METRICS if m.key == key)
        gate = rows.iloc[0]
        passed = "passed" if gate["gate_passed"] else "not passed"
        title = (
            f"{metric.label}: gate {passed} (F = {number(gate['gate_f'])}, permutation "
            f"p = {number(gate['gate_p'], 2)} over {gate['gate_unit']})"
        )
        lines = [
            Row(
                [
                    f"{method_label(row['first'])} {wording.MINUS} {method_label(row['second'])}",
                    with_interval(interval(row, "difference")),
                ],
                faint=not row["gate_passed"],
            )
            for _, row in rows.iterrows()
        ]
        groups.append(Group(title, lines))
    yield Table(
        "Planned contrasts",
        ["Contrast", "Difference of the gaps to the recordings"],
        groups,
        "The contrasts planned in advance, all episodes. Compared is the absolute gap between a "
        "rollout's start-wise mean and the recording (for DTW the distance itself); below zero, "
        "the first method is closer. Contrasts behind a gate that was not passed are pale and "
        "should not be read.",
    )


def _counterfactual(inputs: ReportInputs) -> Iterator[Block]:
    table = inputs.evaluation.counterfactual
    if table.empty:
        return
    names = condition_names(inputs)
    yield Text(
        "The policy is told the other condition; the world stays as it is. The shift is the path "
        "length with the flipped cue minus that with the true one, on the same starts and the "
        "same networks."
    )
    yield Gallery(
        panels.counterfactual_panels(inputs, names),
        "Mean path length with 95 % interval, all episodes: recorded, simulated, and simulated "
        "with the cue flipped (arrow, ringed dot).",
    )
    words = {
        DIFFERENCE: f"{names[0]} {wording.MINUS} {names[1]}",
        ERROR: "absolute error",
        SHIFT: "cue flipped",
        WORLD_SHIFT: "world changed",
    }
    groups = []
    for counting in COUNTING:
        lines = []
        for _, row in table[table["counting"] == counting].iterrows():
            if row["quantity"] not in words:
                continue
            of, told = names[int(row["condition"])], names[int(row["cue"])]
            where = {
                DIFFERENCE: "",
                ERROR: of,
                SHIFT: f"{of} \u2192 {told}",
                WORLD_SHIFT: f"{of} \u2192 {told}",
            }[row["quantity"]]
            lines.append(
                Row(
                    [
                        method_label(str(row["method"])),
                        words[row["quantity"]],
                        where,
                        with_interval(interval(row, "value")),
                        "planned" if row["planned"] else "",
                    ],
                    strong=bool(row["planned"]),
                )
            )
        groups.append(Group(COUNTING[counting].capitalize(), lines))
    yield Table(
        "Counterfactual path lengths",
        ["Method", "Quantity", "Condition", f"Path length\n({PATH_LENGTH.unit})", ""],
        groups,
        "Differences and errors of the mean path length [95 % interval]. An absolute error is "
        "never negative, so its interval cannot include zero.",
        left=3,
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


def _learning(inputs: ReportInputs) -> Iterator[Block]:
    curves = inputs.learning_curves
    if curves is None or curves.empty:
        return
    for phase, rows in curves.groupby("phase", sort=False):
        yield Heading(f"{phase} phase".capitalize())
        yield Gallery(
            panels.learning_panels(rows, offline=phase == "offline"),
            "One thin line per training seed, thick their mean; a single seed is drawn thick.",
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


def condition_names(inputs: ReportInputs) -> tuple[str, str]:
    """Names of conditions 0 and 1, as given or by number."""
    names = tuple(inputs.conditions[:2])
    return (names[0], names[1]) if len(names) == 2 else ("condition 0", "condition 1")


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
