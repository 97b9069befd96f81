"""What is measured of a method: value, interval and null of every measure, and its rank.

A method is better than another where the 95 % interval of the difference of their energy scores,
over demonstrations and seeds, lies below zero. Its rank is then a range: from one more than the
number of methods that are better, to the number of all less those that are worse. Nothing corrects
the pairs for their number.

Submissions are somebody's rollouts, checked and scored without running their code: a file as every
run holds them (``runs/mine/rollouts/*.npz``), or as
:meth:`~animarl_algos.evaluation.rollouts.Rollouts.save` writes them: positions in the arena frame
[arena unit] from the start of a packaged test episode on, which ``demo`` counts.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.benchmark.methods import RECORDINGS, recordings_of_other_starts
from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.metrics import (
    DTW_PER_STEP,
    METRICS,
    SUMMARY,
    Metric,
    summary_table,
)
from animarl_algos.evaluation.prepared import Prepared, censored, comparison_smoothing
from animarl_algos.evaluation.realism import OTHERS
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES, Draws, Interval, covers
from animarl_algos.evaluation.verdict import verdict
from animarl_algos.evaluation.verdict_rows import ALIKE, COLOURS
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError, printable
from animarl_envs.scenario import make_scenario
from animarl_envs.species import Species

SEED = 0  # of all resampling
SLACK = 0.02  # of the contact radius, for rounded positions of a submission
REALISM, ENERGY = "realism", "energy"
UNRANKED = ("recordings", "tracking")
"""References that were told where the recordings go."""
ROUNDING = 1e-9
"""Differences of energy scores up to it are those of sums in another order, and rank nothing."""


def differences() -> list[Metric]:
    """Return the metrics whose difference to the recordings stands on the board."""
    return [one for one in METRICS if one.of_recordings and (one.compared or one.key in SUMMARY)]


def labels() -> dict[str, str]:
    """Return the measures in their order, what a simulator is judged by first, with their names."""
    return {
        REALISM: "realism",
        AUC: "classifier AUC",
        SEQUENCE: "AUC of order in time",
        ENERGY: "energy score",
        **{one.key: one.label[:1].lower() + one.label[1:] for one in differences()},
        DTW_PER_STEP.key: "DTW per step",
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class Score:
    """A method on one set of demonstrations.

    Parameters
    ----------
    covers, words
        What intervals speak of, and the verdict.
    measures
        One row per measure: ``unit``, ``value`` with its interval ``low`` to ``high``, and the
        ``reason`` why there is none. Differences and areas are those of the rows of the verdict,
        with their ``judgement`` and ``colour``; ``inside`` says that such a row is alike, of other
        measures that they are as good as the ``null``: recordings of other starts.
    energies
        ``(seeds, recordings)``: the joint energy score, NaN for none.
    """

    data: str = ""
    kind: str = ""
    method: str
    seeds: tuple[int, ...]
    starts: int
    rollouts: int
    covers: str = ""
    words: str = ""
    measures: list[dict[str, Any]]
    energies: Floats

    @property
    def by_measure(self) -> dict[str, dict[str, Any]]:
        """The rows by their measure."""
        return {row["measure"]: row for row in self.measures}

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values; NaN stays NaN."""
        return vars(self) | {"energies": self.energies.tolist()}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Score:
        """Return what :meth:`to_json` wrote."""
        energies, seeds = np.array(plain["energies"], dtype=np.float64), tuple(plain["seeds"])
        return cls(**{**plain, "energies": energies, "seeds": seeds})


def score(rollouts: Rollouts, demos: Demonstrations, *, resamples: int) -> Score:
    """Measure rollouts from the test starts of ``demos`` against the recordings.

    ``rollouts`` are of one method and all its seeds, ``rollouts.demo`` counts the test episodes;
    recordings of the other splits are what recordings are compared with.
    """
    test, others = demos.select(split="test"), learnable(demos)
    return _score(rollouts, test, recordings_of_other_starts(others, test, SEED), others, resamples)


def crossed_score(
    folds: Sequence[tuple[Demonstrations, Rollouts]], method: str, *, resamples: int
) -> Score:
    """Measure rollouts from the test starts of all folds against the recordings, as one set.

    ``folds`` are, for every fold and seed, the demonstrations as this fold splits them, and the
    rollouts.
    """
    made, beside = [], {}
    for demos, rollouts in folds:
        tested = np.flatnonzero(demos.split == "test")
        made.append(replace(rollouts, demo=tested[rollouts.demo]))
        if int(tested[0]) not in beside:
            others = recordings_of_other_starts(
                demos.select(split="val"), demos.select(split="test"), SEED
            )
            beside[int(tested[0])] = replace(others, demo=tested[others.demo])
    joined = Rollouts.concatenate(made, method)
    return _score(joined, folds[0][0], Rollouts.concatenate([*beside.values()]), None, resamples)


def _score(
    rollouts: Rollouts,
    test: Demonstrations,
    beside: Rollouts,
    others: Demonstrations | None,
    resamples: int,
) -> Score:
    """Against the recordings ``test``; ``beside``: others, each as if it began at a test start."""
    rng_verdict, rng_draws = np.random.default_rng(SEED).spawn(2)
    judged = verdict(test, rollouts, seed=int(rng_verdict.integers(2**31)), references=others)
    prepared = Prepared(test, comparison_smoothing(test))
    counted = censored(rollouts.factual(test), test)
    draws = Draws.by(rng_draws, resamples)
    rows: dict[str, dict[str, Any]] = {}

    def put(
        key: str, value: Interval, null: float, inside: bool, unit: str = "", word: str = ""
    ) -> None:
        rows[key] = statistics.row_of(
            value,
            measure=key,
            unit=unit,
            null=null,
            inside=inside,
            judgement=word,
            colour=COLOURS.get(word, ""),
        )

    for row in judged.rows():
        value, word = Interval(row.value, row.low, row.high, row.reason), row.judgement
        # Over all folds each recording stands on one side itself and on the other as another's: a
        # classifier would learn to call it by the side on which it met it.
        if row.measure in judged.areas and others is None and rollouts.method == RECORDINGS:
            value, word = judged.areas[row.measure]["among"], ALIKE
        put(row.measure, value, math.nan, word == ALIKE, row.unit, word)
    scores = judged.components
    others_score = math.nan if scores is None else float(scores.iloc[-1].get(OTHERS, math.nan))
    put(REALISM, judged.realism, others_score, judged.realism.estimate >= others_score)
    drawn, true = (
        summary_table(prepared, side) for side in (prepared.filtered(counted), prepared.recorded)
    )
    unit = np.unique(test.recording, return_inverse=True)[1].astype(np.int64)
    energies = statistics.energy_cells(drawn, counted.seed, counted.demo, true).by_unit(unit)
    energy, pooled = statistics.bootstrap_mean(energies, draws), statistics.pooled_score(true)
    put(ENERGY, energy, pooled, energy.estimate <= pooled, "recorded SD")
    own, other = (DTW_PER_STEP.measure(prepared.episodes(side)) for side in (counted, beside))
    data = statistics.cells(own, counted.seed, counted.demo, len(test)).by_unit(unit)
    null = float(other.mean())
    dtw = statistics.bootstrap_mean(data, draws)
    put(DTW_PER_STEP.key, dtw, null, dtw.estimate <= null, DTW_PER_STEP.unit)
    return Score(
        method=rollouts.method,
        seeds=tuple(np.unique(counted.seed).tolist()),
        starts=len(np.unique(counted.demo)),
        rollouts=len(counted),
        covers=covers(data),
        words=judged.headline,
        measures=[rows[key] for key in labels() if key in rows],
        energies=energies.cell_means,
    )


def ranked(scores: Sequence[Score], resamples: int) -> dict[str, str]:
    """Return the places that intervals allow a method of one set, such as 2-4, where it has any."""
    energies = {
        one.method: statistics.single_cells(one.energies)
        for one in scores
        if one.method not in UNRANKED and np.isfinite(one.energies).any()
    }
    better, worse = Counter[str](), Counter[str]()
    for first, second in combinations(energies, 2):
        gap = statistics.bootstrap_difference(
            energies[first], energies[second], np.random.default_rng(SEED), resamples
        )
        if gap.excludes_zero and abs(gap.estimate) > ROUNDING:
            winner, loser = (first, second) if gap.high < 0 else (second, first)
            better[loser] += 1
            worse[winner] += 1
    places = {name: (1 + better[name], len(energies) - worse[name]) for name in energies}
    return {
        name: f"{best}" if best == worst else f"{best}\u2013{worst}"
        for name, (best, worst) in places.items()
    }


# -- submissions -----------------------------------------------------------------------------------


def score_submission(path: str | Path, species: str, *, resamples: int = RESAMPLES) -> Score:
    """Check a submission and measure it against the packaged test split of ``species``.

    InputError names the rollout that is not from a test start.
    """
    if species not in packaged_names():
        raise InputError(
            f"--species {printable(species)}: choose among {', '.join(packaged_names())}"
        )
    demos = load_packaged(species)
    rollouts = read_submission(Path(path), species, demos)
    return replace(score(rollouts, demos, resamples=resamples), data=species, kind="method")


def read_submission(path: Path, name: str, demos: Demonstrations) -> Rollouts:
    """Read the rollouts of a file from the test starts of the demonstrations ``name``.

    Only rollouts in the recorded condition, told no other one, count.
    """
    made, test = Rollouts.load(path), demos.select(split="test")
    for key in ("individuals", "roles", "dt"):
        if getattr(made, key) != getattr(test, key):
            raise InputError(
                f"{path}: its {key} ({getattr(made, key)}) are not those of {name} "
                f"({getattr(test, key)}): name the species that was rolled out"
            )
    if made.demo.min() < 0 or made.demo.max() >= len(test):
        wrong = int(np.flatnonzero((made.demo < 0) | (made.demo >= len(test)))[0])
        raise InputError(
            f"{path}: rollout {wrong}: demo is {made.demo[wrong]}: there are 0 to {len(test) - 1}"
        )
    made = made.factual(test)
    if len(set(zip(made.demo.tolist(), made.seed.tolist(), made.repetition.tolist()))) < len(made):
        raise InputError(
            f"{path}: two rollouts have the same demo, seed and repetition: count repetitions up"
        )
    if missing := set(range(len(test))) - set(made.demo.tolist()):
        raise InputError(f"{path}: no rollout is from test episode {min(missing)}: leave none out")
    species = make_scenario(test.species, demos=demos).species
    for i, demo in enumerate(made.demo.tolist()):
        if fault := _fault(made.path(i), int(made.outcome[i]), demo, test, species):
            raise InputError(f"{path}: rollout {i}: {fault}")
    return replace(made, method=printable(made.method))


def _fault(path: Floats, outcome: int, demo: int, test: Demonstrations, species: Species) -> str:
    """Return why a rollout is not one from the start of test episode ``demo``; empty if it is."""
    movers = sum(role != "target" for role in test.roles)
    if not 2 <= len(path) <= species.time_limit + 1:
        return (
            f"it has {len(path)} frames, and an episode 2 to {species.time_limit + 1}: give every "
            "frame"
        )
    if np.abs(path[0] - test.path(demo)[0]).max() > SLACK * species.contact_radius:
        return f"it does not begin where test episode {demo} began"
    if not PURSUER_OUT <= outcome <= movers:
        return (
            f"outcome {outcome} is not a valid code: use {PURSUER_OUT} to {movers} "
            "(animarl_envs/demos/episode.py)"
        )
    return ""
