"""Answers to what-if questions: changed world beside unchanged world, paired, with intervals.

Nobody learns: the same policies act in another world. Baseline and scenario start from the same
recordings and meet the same random numbers, so that they differ by the change alone.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import pandas as pd

from animarl_algos.evaluation.prepared import censored, comparison_smoothing
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.whatif.absent import Present, simulate_from
from animarl_algos.whatif.changes import CONDITION, ChangedWorld, parse_scenarios
from animarl_algos.whatif.extrapolation import RED, YELLOW, Caution, InputRange, WatchedPolicy
from animarl_algos.whatif.quantities import (
    ALL,
    Quantity,
    measured_quantities,
    quantities_of,
    resolve_measures,
    speeds_of,
)
from animarl_algos.whatif.shifts import (
    CANNOT_TELL,
    FALLS,
    RISES,
    calibrated,
    chance_error,
    disagrees,
    judge,
    mean_over_starts,
    share_as_large,
    shift_between_conditions,
    tips_over,
    units_of_starts,
    widen_for_family,
    widen_shift_of_share,
)
from animarl_algos.whatif.thrust_search import LIMITS, ThrustSearch
from animarl_algos.whatif.truth import Truth, mean_by_start, subtract
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.demos.summary import Unit, unit_of
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.species import Species
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world

REPETITIONS = 5
SHARE = "share"  # the unit of quantities that each episode has or not
MOST_TRIES = 24  # of the thrusts for wanted speeds
TRY_REPETITIONS = 2


class UnmetSpeedError(InputError):
    """No thrust brings an individual to the wanted speed."""


class TrainedRun(Protocol):
    """A finished run, :class:`animarl_algos.runs.run.Run`."""

    @property
    def scenario(self) -> Scenario:
        """Its world, with starts."""

    @property
    def demos(self) -> Demonstrations:
        """Recordings of all splits."""

    @property
    def policy(self) -> Any:
        """The trained learner."""

    @property
    def has_condition_flag(self) -> bool:
        """Whether the policy has a condition flag among its inputs."""

    def starting_from(self, split: str | None, *more: Any, **options: Any) -> Scenario:
        """Return its world with other starts."""

    def roll_out(self, *given: Any, **options: Any) -> Rollouts:
        """Return rollouts of a policy."""


@dataclass(frozen=True, eq=False)
class Answer:
    """The answer to one scenario.

    Parameters
    ----------
    scenario
        What was changed.
    table
        One row per quantity: ``scenario, quantity, unit, recorded, baseline, baseline_error,
        changed, changed_error, shift, low, high, gap, covers, other_reading, seeds_low, seeds_high,
        beyond, null_low, null_high, p, warning, judged, finding``. The errors are those of chance
        (:func:`~animarl_algos.whatif.shifts.chance_error`). ``gap`` is baseline minus recorded,
        where rollouts stop with a recording that was cut
        (:func:`~animarl_algos.evaluation.prepared.censored`).
        ``second_shift, second_low, second_high, second_gap`` are of a simulator with other inputs,
        if one was asked. Of a condition, ``trained_shift`` and its ``trained_margin`` are the
        difference between the recordings that were learned from, and ``trained_miss`` is how far
        that lies above the shift that is simulated from their starts.
        ``seeds_low`` to ``seeds_high`` is the range of the shifts of single training seeds,
        ``beyond`` the share of steps more than usual with inputs that training did not have.
        ``null_low`` to ``null_high`` is where 95 % of the shifts of runs with permuted labels lie,
        and ``p`` how often these move any quantity as far.
        ``calibrated`` is the shift, of a condition corrected by ``trained_miss``, and
        ``calibrated_low`` to ``calibrated_high`` its interval, as wide as such answers have been
        wrong (:func:`~animarl_algos.whatif.shifts.calibrated`).
        ``judged`` is what :func:`judge` says, and ``finding`` is true where a quantity rises or
        falls. Where the truth is known, ``true, true_low, true_high`` are the true shift, and
        ``miss, miss_low, miss_high`` the predicted minus the true one.
    warning
        ``none``, ``some`` or ``red``.
    reason
        Why to distrust the answer, in words; empty without a warning.
    thrusts
        Factors on thrusts with which wanted speeds were achieved, by individual.
    rollouts
        In the changed world, of all runs.
    species
        The changed world.
    true
        Episodes of the truth in the changed world, where it is known.
    """

    scenario: ChangedWorld
    table: pd.DataFrame
    warning: str
    reason: str
    thrusts: Mapping[str, float]
    rollouts: Rollouts
    species: Species
    true: Rollouts | None = None


@dataclass(frozen=True, eq=False)
class WhatIf:
    """Baseline and answers of all scenarios.

    Parameters
    ----------
    demos, species
        The starts, and the unchanged world.
    runs, repetitions
        Training seeds, and rollouts from each start and of each of them.
    reading
        What policies perceive of a changed body.
    truth
        What made the recordings, where it is known.
    other_measures
        Keys of the verdict's measures that are not in the table.
    unmet
        By the name of a scenario whose wanted speed no thrust gives, a sentence that says so.
    """

    baseline: Rollouts
    answers: tuple[Answer, ...]
    demos: Demonstrations
    species: Species
    runs: int
    repetitions: int
    reading: Reading
    truth: Truth | None = None
    other_measures: tuple[str, ...] = ()
    unmet: Mapping[str, str] = field(default_factory=dict)

    @property
    def table(self) -> pd.DataFrame:
        """All answers, one row per scenario and quantity; one row where a speed is not met."""
        rows = [{"scenario": s, "judged": why, "finding": False} for s, why in self.unmet.items()]
        tables = [answer.table for answer in self.answers] + [pd.DataFrame(rows)] * bool(rows)
        return pd.concat(tables, ignore_index=True)


def ask(
    runs: Sequence[TrainedRun],
    changes: Sequence[str],
    *,
    repetitions: int = REPETITIONS,
    reading: Reading = "habit",
    separately: bool = False,
    family: bool = True,
    seed: int = 0,
    permuted: Sequence[TrainedRun] = (),
    second: TrainedRun | None = None,
    truth: Truth | None = None,
    measures: Sequence[str] = (),
    on_baseline: Callable[[pd.DataFrame], None] | None = None,
    on_answer: Callable[[Answer], None] | None = None,
) -> WhatIf:
    """Simulate trained runs in changed worlds, and compare each with the unchanged world.

    Parameters
    ----------
    runs
        Of one learner in one world; several are training seeds.
    changes
        As :func:`~animarl_algos.whatif.changes.parse_scenarios` reads them.
    repetitions
        Rollouts from each test start and run.
    reading
        What policies perceive of a changed body (:data:`animarl_envs.species.base.Reading`).
    separately
        Whether every change is a scenario of its own.
    family
        Whether the intervals of several scenarios hold together.
    seed
        Of the resamples.
    permuted
        Runs of the same learner that were trained with the conditions of their recordings permuted
        (:func:`animarl_algos.runs.permuted.permuted_runs`). Their shifts are the null of a
        cue: they say how far it moves by the choice of training recordings alone.
    second
        A run with other inputs (:func:`animarl_algos.runs.permuted.second_run`), which is asked the
        same of changed worlds: where both disagree, the recordings cannot tell.
    truth
        What made the recordings (:func:`animarl_algos.whatif.truth.find_truth`): its shift stands
        beside the predicted one.
    measures
        Names of measures of the verdict that are asked too, or ``all``.
    on_baseline
        Called first with how far the unchanged simulation is from the recordings; columns
        ``quantity, unit, recorded, baseline, baseline_error, gap``.
    on_answer
        Called with each answer when it is ready.

    Raises
    ------
    InputError
        If a change is unknown or cannot be made, or runs are not of the same animals; nothing is
        simulated then. If no scenario can be met.
    """
    scenarios, keys = check_changes(
        runs, changes, separately=separately, truth=truth, measures=measures
    )
    first = runs[0]
    species, unit = first.scenario.species, unit_of(first.demos)
    comparison, *nulls = (
        _Comparison(some, unit, repetitions, reading, seed, keys)
        for some in (runs, *([run] for run in permuted))
    )
    comparison.truth, comparison.answers = truth, len(scenarios) if family else 1
    other = None
    if second is not None and any(scenario.condition is None for scenario in scenarios):
        other = _Comparison([second], unit, repetitions, reading, seed, keys)
    if on_baseline is not None:
        on_baseline(comparison.unchanged())
    answers, unmet = [], {}
    for scenario in scenarios:
        try:
            answers.append(
                comparison.answer(scenario, nulls if scenario.condition is not None else (), other)
            )
        except UnmetSpeedError as error:
            unmet[scenario.name] = str(error)
            continue
        if on_answer is not None:
            on_answer(answers[-1])
    if not answers:
        raise InputError("; ".join(unmet.values()))
    return WhatIf(
        comparison.baseline,
        tuple(answers),
        comparison.test,
        species,
        len(runs),
        repetitions,
        reading,
        truth,
        tuple(key for key in resolve_measures([ALL], comparison.test) if key not in keys),
        unmet,
    )


def check_changes(
    runs: Sequence[TrainedRun],
    changes: Sequence[str],
    *,
    separately: bool = False,
    truth: Truth | None = None,
    measures: Sequence[str] = (),
) -> tuple[list[ChangedWorld], tuple[str, ...]]:
    """Return the scenarios, and the keys of the measures, without simulating anything.

    Raises
    ------
    InputError
        As :func:`ask`.
    """
    first = runs[0]
    species = first.scenario.species
    for run in runs:
        names = run.scenario.species.individuals
        if names != species.individuals or len(run.demos) != len(first.demos):
            raise InputError(
                f"runs are of different recordings ({', '.join(names)} in {len(run.demos)} "
                f"episodes, {', '.join(species.individuals)} in {len(first.demos)}): give training "
                "seeds of one learner"
            )
    scenarios = parse_scenarios(changes, species, separately=separately)
    for scenario in scenarios:
        _check(scenario, first, unit_of(first.demos))
        if truth is not None:
            truth.check(scenario)
    return scenarios, resolve_measures(measures, first.demos.select(split="test"))


def _check(scenario: ChangedWorld, run: TrainedRun, unit: Unit) -> None:
    """Refuse a change that cannot be made, before anything is simulated."""
    species = change_world(run.scenario.species, **scenario.options(run.scenario.species, unit))
    for change in scenario.speeds:
        assert not isinstance(change.amount, str)
        change.amount.of(1.0, {f"{unit.name}/s": 1.0}, change.text)
    scenario.move_starts(run.demos.select(split="test"), species)
    if scenario.removed:
        Present.without(species, scenario.removed)
    sensed = run.scenario.species.condition_is_sensed
    if scenario.condition is None:
        return
    if not sensed and not run.has_condition_flag:
        raise InputError(
            "the policies of this run have no input for the condition, so it cannot be changed: "
            "train a run on recordings of both conditions"
        )
    starts = run.demos.select(split="test").condition
    if (starts == species.conditions.index(scenario.condition)).all():
        raise InputError(
            f"condition={scenario.condition}: all test recordings are of this condition already, "
            "so there is none to change: deal the splits so that test has both conditions"
        )


class _Comparison:
    """Simulates the unchanged world and each scenario once, and compares them."""

    def __init__(
        self,
        runs: Sequence[TrainedRun],
        unit: Unit,
        repetitions: int,
        reading: Reading,
        seed: int,
        keys: Sequence[str],
    ) -> None:
        self.runs, self.unit, self.repetitions = runs, unit, repetitions
        self.reading, self.seed, self.keys = reading, seed, keys
        self.truth: Truth | None = None
        self.answers = 1  # whose intervals hold together
        self.species = runs[0].scenario.species
        self.test = runs[0].demos.select(split="test")
        self.ranges = [
            InputRange.of(run.scenario.species, run.demos.select(split="train")) for run in runs
        ]
        self.baseline, *self.usual = self._simulate(ChangedWorld(()), {}, "habit")
        self.smoothing = comparison_smoothing(self.test) if keys else 1
        recorded = Rollouts.from_demonstrations(self.test)
        self.measured = [
            quantity
            for quantity in measured_quantities(self.test, unit, keys, self.smoothing)
            if np.isfinite(quantity.values(recorded)).any()
        ]
        # What stands beside recordings that were cut stops there too.
        self.comparable = censored(self.baseline, self.test)

    def answer(
        self,
        scenario: ChangedWorld,
        nulls: Sequence[_Comparison] = (),
        second: _Comparison | None = None,
    ) -> Answer:
        """Compare one scenario with the baseline.

        A cue's shifts stand beside those of ``nulls`` and of the recordings that were learned from,
        those of a changed world beside those of a ``second`` simulator.
        """
        thrusts = self._thrusts(scenario)
        options = scenario.options(self.species, self.unit, thrusts)
        changed, *beyond = self._simulate(scenario, options, self.reading)
        other = None
        if scenario.moves_bodies:
            reading: Reading = "knows" if self.reading == "habit" else "habit"
            other = self._simulate(scenario, options, reading)[0]
        true = None if self.truth is None else self.truth.roll_out(scenario, self.reading)
        table = pd.DataFrame(self._rows(scenario, changed, other, true))
        beside: dict[str, Any] = {}
        if scenario.condition is not None:
            beside = self._learned_from(scenario)
        elif second is not None:
            keys = ("shift", "low", "high", "gap")
            beside = {
                row["quantity"]: {f"second_{key}": row[key] for key in keys}
                for row in second.rows(scenario, thrusts)
            }
        table = table.join(pd.DataFrame(beside).T, on="quantity") if beside else table
        more, inputs = (now - usual for now, usual in zip(beyond, self.usual))
        species = change_world(self.species, **options)
        warning, reason = self._warning(more, inputs, table, self._tipping(species, changed))
        low = high = p = np.full(len(table), np.nan)
        if nulls:
            null = [[row["shift"] for row in one.rows(scenario, thrusts)] for one in nulls]
            low, high = np.nanquantile(null, [0.025, 0.975], axis=0)
            p = share_as_large(table["shift"].to_numpy(), np.array(null))
        table = table.assign(
            beyond=np.nanmax(more), null_low=low, null_high=high, p=p, warning=warning
        )
        cue = scenario.condition is not None and not self.species.condition_is_sensed
        table["judged"] = [judge(row, of_a_cue=cue) for row in table.to_dict("records")]
        table[["calibrated", "calibrated_low", "calibrated_high"]] = [
            calibrated(row) for row in table.to_dict("records")
        ]
        table["finding"] = table["judged"].isin((RISES, FALLS))
        if scenario.removed:
            species = Present.without(species, scenario.removed).species
        changed_truth = true[1] if true is not None else None
        return Answer(scenario, table, warning, reason, thrusts, changed, species, changed_truth)

    def unchanged(self) -> pd.DataFrame:
        """Return each quantity of the recordings and of the unchanged world, cut as they were."""
        table = pd.DataFrame(self._rows(ChangedWorld(()), self.baseline, None))
        table["baseline"] = table["recorded"] + table["gap"]
        return table[["quantity", "unit", "recorded", "baseline", "baseline_error", "gap"]]

    def rows(
        self, scenario: ChangedWorld, thrusts: Mapping[str, float]
    ) -> Iterator[dict[str, Any]]:
        """Return the rows of an answer that stands beside another."""
        options = scenario.options(self.species, self.unit, thrusts)
        return self._rows(scenario, self._simulate(scenario, options, self.reading)[0], None)

    @cached_property
    def _learned(self) -> tuple[Demonstrations, Rollouts]:
        """Return recordings that were learned from, and the unchanged world from their starts."""
        known = learnable(self.runs[0].demos)
        return known, self._simulate(ChangedWorld(()), {}, self.reading, 1, known)[0]

    def _learned_from(self, scenario: ChangedWorld) -> dict[str, dict[str, float]]:
        """Return by quantity what recordings show of a condition that were learned from.

        How they differ by it, and how far that is above what is simulated from their starts.
        """
        known, before = self._learned
        recorded = Rollouts.from_demonstrations(known)
        treated = known.condition == self.species.conditions.index(str(scenario.condition))
        condition_alone = replace(
            scenario, changes=tuple(one for one in scenario.changes if one.what == CONDITION)
        )
        after = self._simulate(condition_alone, {}, self.reading, 1, known)[0]
        measured = measured_quantities(known, self.unit, self.keys, self.smoothing)
        statistics = {}
        for quantity in (*quantities_of(recorded, self.unit), *(measured if self.keys else ())):
            shift, margin = shift_between_conditions(
                quantity.values(recorded), treated, known.recording
            )
            shifts = quantity.values(after) - quantity.values(before)
            statistics[quantity.name] = {
                "trained_shift": shift,
                "trained_margin": margin,
                "trained_miss": shift - np.nanmean(shifts[~treated[after.demo]]),
            }
        return statistics

    def _simulate(
        self,
        scenario: ChangedWorld,
        options: Mapping[str, Any],
        reading: Reading,
        repetitions: int | None = None,
        starts: Demonstrations | None = None,
    ) -> tuple[Rollouts, Floats, Floats]:
        """Return rollouts of all runs, and shares of inputs beyond their range.

        From test starts unless others are given. Shares are NaN for removed individuals.
        """
        parts: list[Rollouts] = []
        names = self.species.individuals
        starts = self.test if starts is None else starts
        moved = scenario.move_starts(starts, change_world(self.species, **options))
        there = [i for i, name in enumerate(names) if name not in scenario.removed]
        cue: dict[str, Any] = {}
        if scenario.condition is not None:
            index = self.species.conditions.index(scenario.condition)
            cue = {"condition" if self.species.condition_is_sensed else "flag": index}
        words = self.ranges[0].words
        beyond = np.full((len(self.runs), len(names)), np.nan)
        inputs, sides = np.full((len(names), len(words)), np.nan), []
        for number, (run, ranges) in enumerate(zip(self.runs, self.ranges)):
            watched = WatchedPolicy(run.policy, ranges.of_individuals(there))
            parts.append(
                simulate_from(
                    run,
                    moved,
                    scenario.removed,
                    repetitions=repetitions or self.repetitions,
                    reading=reading,
                    wrap=watched.rewrap,
                    **cue,
                    **options,
                )
            )
            beyond[number, there], departures = watched.shares()
            if ranges.words == words:  # simulators of other folds may perceive other things
                sides.append(departures)
        inputs[there] = np.mean(sides, axis=0)
        return Rollouts.concatenate(parts), beyond.mean(axis=0), inputs

    def _thrusts(self, scenario: ChangedWorld) -> dict[str, float]:
        """Find by simulation the thrusts at which wanted speeds are achieved."""
        wanted: dict[str, float] = {}  # [arena unit / s]
        usual = _speeds(self.baseline)  # of more rollouts than a try
        scales = {f"{self.unit.name}/s": 1.0 / self.unit.per_arena_unit}
        for change in scenario.speeds:
            assert not isinstance(change.amount, str)
            wanted |= {
                n: change.amount.of(usual[n], scales, change.text) for n in change.individuals
            }
        searches = {name: ThrustSearch(speed, usual[name]) for name, speed in wanted.items()}
        for _ in range(MOST_TRIES if wanted else 0):
            factors = {name: search.factor for name, search in searches.items()}
            options = scenario.options(self.species, self.unit, factors)
            achieved = _speeds(self._simulate(scenario, options, self.reading, TRY_REPETITIONS)[0])
            for name, search in searches.items():
                search.record(achieved[name])
            missed = [name for name, search in searches.items() if not search.is_met]
            if not missed:
                return factors
            stuck = [name for name in missed if not searches[name].advance()]
            if stuck:
                missed = stuck
                break
        if not wanted:
            return {}
        name, scale = missed[0], self.unit.per_arena_unit
        raise UnmetSpeedError(
            f"{scenario.name}: no thrust between x{LIMITS[0]:g} and x{LIMITS[1]:g} brings {name} "
            f"to {wanted[name] * scale:.3g} {self.unit.name}/s: "
            f"{searches[name].describe_failure(scale)}; ask for another speed, or change the "
            f"thrust: {name}.thrust=x1.2"
        )

    def _rows(
        self,
        scenario: ChangedWorld,
        changed: Rollouts,
        other: Rollouts | None,
        true: tuple[Rollouts, Rollouts] | None = None,
    ) -> Iterator[dict[str, Any]]:
        """Yield one row per quantity."""
        covers = "starts and training runs" if len(self.runs) > 1 else "starts, for this network"
        counts = np.ones(len(changed), dtype=bool)
        if scenario.condition is not None:
            index = self.species.conditions.index(scenario.condition)
            counts = self.test.condition[changed.demo] != index
        recorded = Rollouts.from_demonstrations(self.test)
        starts = np.unique(changed.demo[counts])
        units = len(np.unique(units_of_starts(changed.demo, self.test, counts)[starts]))
        named = {name for change in scenario.changes for name in change.individuals}
        if len(named) == len(self.species.individuals):
            named = set()
        measures = {q.name: q for q in self._quantities_after(scenario, changed, named)}
        for quantity in (*quantities_of(self.species, self.unit, named), *self.measured):
            if quantity.name not in measures:  # of a removed individual
                continue
            measure = measures[quantity.name].values
            before, after = quantity.values(self.baseline), measure(changed)
            shift = self._mean(after - before, changed.demo, counts)
            if quantity.unit == SHARE:
                shift = widen_shift_of_share(
                    shift, before, after, changed.demo, test=self.test, counts=counts
                )
            shift = widen_for_family(shift, self.answers, units)
            further = float("nan")
            if other is not None:
                further = self._mean(measure(other) - before, other.demo, counts).estimate
            baseline = self._mean(before, self.baseline.demo, counts).estimate
            real = float(np.nanmean(quantity.values(recorded)[starts]))
            comparable = quantity.values(self.comparable)
            gap = self._mean(comparable, self.comparable.demo, counts).estimate - real
            counted = np.where(counts, after - before, np.nan).reshape(len(self.runs), -1)
            known = np.isfinite(counted).sum(axis=1)
            seeds = np.nansum(counted, axis=1) / np.where(known, known, np.nan)
            yield {
                "scenario": scenario.name,
                "quantity": quantity.name,
                "unit": quantity.unit,
                "recorded": real,
                "baseline": baseline,
                "baseline_error": self._chance(before, self.baseline.demo, counts),
                "changed": baseline + shift.estimate,
                "changed_error": self._chance(after, changed.demo, counts),
                "shift": shift.estimate,
                "low": shift.low,
                "high": shift.high,
                "gap": gap,
                "covers": covers,
                "other_reading": further,
                "seeds_low": seeds.min(),
                "seeds_high": seeds.max(),
            } | (
                {}
                if true is None
                else self._compare_with_truth(
                    true,
                    (quantity.values(true[0]), measure(true[1])),
                    changed,
                    after - before,
                    counts,
                )
            )

    def _quantities_after(
        self, scenario: ChangedWorld, changed: Rollouts, named: Collection[str]
    ) -> Iterator[Quantity]:
        """Yield the quantities of the changed world: of its animals, and of its walls."""
        yield from quantities_of(changed, self.unit, named)
        if self.keys:
            there = [self.species.individuals.index(name) for name in changed.individuals]
            demos = self.test.of_individuals(there) if scenario.removed else self.test
            world = change_world(self.species, **scenario.options(self.species, self.unit))
            demos = replace(demos, arena=world.arena)
            yield from measured_quantities(demos, self.unit, self.keys, self.smoothing)

    def _chance(self, values: Floats, demo: Ints, counts: Bools) -> float:
        """Return the error of a mean by the chance of its rollouts."""
        run = np.repeat(np.arange(len(self.runs)), len(values) // len(self.runs))
        return chance_error(values, run * len(self.test) + demo, counts)

    def _compare_with_truth(
        self,
        true: tuple[Rollouts, Rollouts],
        values: tuple[Floats, Floats],
        changed: Rollouts,
        shifts: Floats,
        counts: Bools,
    ) -> dict[str, float]:
        """Return the true shift of a quantity, and the predicted minus the true one.

        Parameters
        ----------
        true, values
            True episodes in the unchanged and in the changed world, and the quantity of each.
        changed, shifts, counts
            Rollouts in the changed world, the shift of each, and whether it counts.
        """
        assert self.truth is not None
        if self.truth.paired:
            starts = np.arange(len(self.test))
            before, after = (mean_by_start(*pair, len(starts)) for pair in zip(true, values))
            by_start, counted = after - before, np.isin(starts, changed.demo[counts])
            effect = self._mean(by_start, starts, counted, runs=1)
            miss = self._mean(shifts - by_start[changed.demo], changed.demo, counts)
        else:
            usual, there = (
                self._mean(one, made.demo, np.ones(len(one), dtype=bool), runs=1)
                for made, one in zip(true, values)
            )
            effect = subtract(there, usual)
            miss = subtract(self._mean(shifts, changed.demo, counts), effect)
        return {
            f"{name}{end}": number
            for name, value in (("true", effect), ("miss", miss))
            for end, number in (("", value.estimate), ("_low", value.low), ("_high", value.high))
        }

    def _mean(
        self,
        values: Floats,
        demo: Ints,
        counts: Bools,
        runs: int | None = None,
    ) -> Interval:
        return mean_over_starts(
            values,
            demo,
            runs=runs or len(self.runs),
            test=self.test,
            rng=np.random.default_rng(self.seed),
            counts=counts,
        )

    def _tipping(self, species: Species, changed: Rollouts) -> list[str]:
        """Name individuals with a speed that changes far more than their thrust."""
        usual, reasons = _speeds(self.baseline), []
        for name, now in _speeds(changed).items():
            i = species.individuals.index(name)
            thrust = species.locomotion[i].thrust / self.species.locomotion[i].thrust
            speed = now / max(usual[name], 1e-12)
            if thrust != 1.0 and tips_over(thrust, speed):
                reasons.append(
                    f"the speed of {name} is x{speed:.2g} by a thrust of x{thrust:.2g}: between "
                    "rest and motion this simulator tips over, and small changes have large effects"
                )
        return reasons

    def _warning(
        self, more: Floats, inputs: Floats, table: pd.DataFrame, reasons: list[str]
    ) -> tuple[str, str]:
        """Return the warning, and the reasons for it beside those given."""
        worst = int(np.nanargmax(more))
        word = Caution.SOME if reasons else Caution.NONE
        if more[worst] > YELLOW:
            word = Caution.RED if more[worst] > RED else Caution.SOME
            reasons.append(
                f"in {more[worst]:.0%} more steps than usual {self.species.individuals[worst]} "
                "perceives what it never did in training: most often, "
                f"{self.ranges[0].what(worst, int(np.argmax(inputs[worst])))}"
            )
        clear = (table["low"] > 0) | (table["high"] < 0)
        turned = table.loc[clear & (table["other_reading"] * table["shift"] < 0), "quantity"]
        if len(turned):
            word = Caution.RED if word == Caution.RED else Caution.SOME
            reasons.append(
                f"habit and knowledge of the new body disagree on the sign of {', '.join(turned)}"
            )
        for row in filter(disagrees, table.to_dict("records")):
            word = Caution.RED if word == Caution.RED else Caution.SOME
            factor, unit = (100.0, "points") if row["unit"] == SHARE else (1.0, row["unit"])
            reasons.append(
                f"{row['quantity']} {CANNOT_TELL}: its shift is {factor * row['shift']:+.3g} {unit}"
                f", and {factor * row['second_shift']:+.3g} by a simulator with other inputs"
            )
        return word, "; ".join(reasons)


def _speeds(rollouts: Rollouts) -> dict[str, float]:
    """Return the mean speed of each individual over episodes [arena unit / s]."""
    return dict(zip(rollouts.individuals, speeds_of(rollouts).mean(axis=0).tolist(), strict=True))
