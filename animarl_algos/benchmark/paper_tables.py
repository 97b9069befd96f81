"""Tables of the paper made anew, from records alone, with what the paper published."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.benchmark.departures import DEPARTURES, setting_of
from animarl_algos.benchmark.paper import (
    ADAPTED,
    COUNTERFACTUAL,
    JOINT,
    LEARNERS,
    ONSET,
    SIMULATED,
    PaperCell,
    Record,
    Scope,
    count_speeds,
    speed_edges,
)
from animarl_algos.evaluation.metrics import DTW, DURATION, PATH_LENGTH, measure, measure_recordings
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED, Rollouts
from animarl_algos.evaluation.statistics import (
    Cells,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    mean_over_seeds,
    percentile_interval,
    row_of,
)
from animarl_algos.evaluation.teams import roll_out_teams, teams_of
from animarl_algos.whatif.truth import subtract
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.species import get_species

TRUTH, CLONE = "truth", "soft-bc"
DEFAULT = "preset default"
"""DQDIL-PT as this project would train it, beside its departures from the published settings."""
NO_WORLD = "–"
REACHED, REALISM = "reached", "realism"
GAIN, REACHED_GAIN = "realism above the clone", "reached above the clone"
SEED, RESAMPLES = 0, 1000
DENSITY_POINTS, DENSITY_MARGIN = 512, 4.0  # of a grid, which reaches so many bandwidths further
NARROWEST = 0.01  # no bandwidth is smaller than this share of the pooled range
COLUMNS = [
    *("species", "setting", "learner", "steps", "seeds", "commit", "quantity", "verdict"),
    *("measure", "published", "value", "low", "high", "reason"),
]


def published(part: str) -> dict[tuple[str, str, str], str]:
    """Return what the paper gives, or a cell costs, by species, row and measure."""
    table = pd.read_csv(Path(__file__).with_name("published.csv"), dtype=str)
    rows = table[table["part"] == part].drop(columns="part").itertuples(index=False)
    return {(species, row, measure): value for species, row, measure, value in rows}


# -- kernel-density distances ----------------------------------------------------------------------


def densities(samples: Sequence[Floats]) -> tuple[list[Floats], float]:
    """Return each value's Gaussian on a shared grid, ``(values, points)``, and the grid's step.

    Bandwidths are Scott's, but never less than :data:`NARROWEST` of the pooled range: where every
    episode times out, values have no variance.
    """
    pooled = np.concatenate(samples)
    narrowest = NARROWEST * (float(np.ptp(pooled)) or 1.0)
    widths = [
        max(narrowest, np.std(one, ddof=1) * len(one) ** -0.2 if len(one) > 1 else 0.0)
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
    return float(np.abs(one.mean(0) - other.mean(0)).sum() * step)


def kde_interval(rows: pd.DataFrame, truth: pd.DataFrame, key: str) -> Interval:
    """Return a method's distance, the mean of its seeds', with percentiles.

    Seeds and demonstrations are resampled, at the bandwidths of whole samples. Rollouts of several
    seeds are not pooled: of seeds that err on either side, together they look nearer than any one.
    """
    rng = np.random.default_rng(SEED)
    known = truth.sort_values("demo")[key].to_numpy(float)
    of_demos, of_seeds = (
        rng.multinomial(number, np.full(number, 1 / number), RESAMPLES)
        for number in (len(known), rows["seed"].nunique())
    )
    estimates, drawn = [], []
    for _, own in rows.groupby("seed"):
        values = own[key].to_numpy(float)
        (one, other), step = densities([values, known])
        weights = of_demos[:, own["demo"].to_numpy()]
        simulated = weights @ one / weights.sum(1, keepdims=True)
        drawn.append(np.abs(simulated - of_demos @ other / len(known)).sum(1) * step)
        estimates.append(kde_distance(values, known))
    return percentile_interval(float(np.mean(estimates)), np.average(drawn, 0, of_seeds.T))


# -- what was found --------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Findings:
    """Records of a scope, and the tables that come from them.

    ``records`` has each cell, its record if there is one, and whether that is a kept one.
    """

    scope: Scope
    records: Sequence[tuple[PaperCell, Record | None, bool]]

    def of(self, species: str, setting: str, learner: str) -> list[Record]:
        """Return the records of all seeds."""
        wanted = (species, setting, learner)
        return [
            record
            for one, record, _ in self.records
            if record is not None and (one.cell.data, one.setting, one.cell.method) == wanted
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
    def tests(self) -> dict[str, Demonstrations]:
        """Return the test split of every species."""
        demos = {one.cell.data: one.demos for one, _, _ in self.records}
        return {name: one.select(split="test") for name, one in demos.items()}

    @cached_property
    def recorded(self) -> dict[str, pd.DataFrame]:
        """Return the measured recordings of every species."""
        return {name: measure_recordings(test) for name, test in self.tests.items()}

    def gather(self, rows: pd.DataFrame, species: str, key: str) -> Cells:
        """Return the values of rollouts by seed and start."""
        columns = rows if len(rows) else pd.DataFrame({key: [], "seed": [], "demo": []}, dtype=int)
        return cells(columns[key], columns["seed"], columns["demo"], len(self.tests[species]))

    @cached_property
    def table1(self) -> pd.DataFrame:
        """Return published, true and fitted locomotion, a row per individual and parameter."""
        paper, rows = published("table1"), []
        fields = {"damping": "damping", "thrust": "thrust", "rmse": "velocity_rmse"}
        for name, demos in {one.cell.data: one.demos for one, _, _ in self.records}.items():
            fits = {method: fit_locomotion(demos, method, bootstrap=0) for method in (ONSET, JOINT)}
            for (i, individual), (key, field) in product(
                enumerate(demos.individuals), fields.items()
            ):
                row: dict[str, Any] = {"species": name, "individual": individual}
                row["parameter"] = key
                row["published"] = float(paper[name, individual, key])
                row["true"] = getattr(get_species(name).locomotion[i], key, np.nan)
                fitted = {
                    method: getattr(fit.individuals[i], field) for method, fit in fits.items()
                }
                rows.append(row | fitted)
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
            head = {"species": name, "low": edges[:-1], "high": edges[1:]}
            parts.append(pd.DataFrame(head | counts))
        return pd.concat(parts, ignore_index=True)

    @cached_property
    def figure4(self) -> pd.DataFrame:
        """Return shares reached and distances to the recordings, by learner and world."""
        paper, rows = published("figure4"), []
        for name, setting, learner in product(self.tests, (ONSET, JOINT), LEARNERS):
            own, clone = (self.rows(name, setting, one) for one in (learner, "bc"))
            if own.empty:
                continue
            draws = Draws.by(np.random.default_rng(SEED))
            captured = self.gather(own, name, "captured")
            intervals = {REACHED: bootstrap_mean(captured, draws, share=True)}
            for key in (DURATION.key, PATH_LENGTH.key):
                intervals[key] = kde_interval(own, self.recorded[name], key)
            if learner != "bc" and len(clone):
                theirs, its = (self.gather(one, name, DTW.key) for one in (clone, own))
                intervals[DTW.key] = bootstrap_difference(theirs, its, draws)
            commits = {one.about["commit"][:7] for one in self.of(name, setting, learner)}
            head: dict[str, Any] = {"species": name, "setting": setting, "learner": learner}
            head |= {"seeds": own["seed"].nunique(), "commit": " ".join(sorted(commits))}
            rows += [
                row_of(value, **head, measure=key, published=paper.get((name, learner, key), ""))
                for key, value in intervals.items()
            ]
        return pd.DataFrame(rows, columns=COLUMNS)

    @cached_property
    def figure5(self) -> pd.DataFrame:
        """Return path lengths and durations by condition, their shifts, errors and truth."""
        rows = []
        for name, test in self.tests.items():
            if not get_species(name).conditions:
                continue
            recorded, nothing = self.recorded[name].assign(cue=NO_CUE), pd.DataFrame()
            given = {(RECORDED, NO_WORLD): (recorded, nothing)} | self._truth(name)
            for learner, setting in product(COUNTERFACTUAL, (ONSET, JOINT)):
                factual, flipped = (self.rows(name, setting, learner, f) for f in (False, True))
                if len(factual):
                    given[learner, setting] = factual, flipped
            for ((learner, setting), pair), key in product(
                given.items(), (PATH_LENGTH.key, DURATION.key)
            ):
                head: dict[str, Any] = {"species": name, "setting": setting, "learner": learner}
                head["quantity"] = key
                head["seeds"] = "" if setting == NO_WORLD else pair[0]["seed"].nunique()
                rows += self._shifts(test, [*pair, recorded], head)
        return pd.DataFrame(rows, columns=COLUMNS)

    def _shifts(
        self, test: Demonstrations, sides: Sequence[pd.DataFrame], head: Mapping[str, Any]
    ) -> list[dict[str, Any]]:
        """Return the rows of one learner; ``sides`` are factual, flipped and recorded episodes."""
        paper, intervals = published("figure5"), dict[str, Interval]()
        draws, means = Draws.by(np.random.default_rng(SEED)), []
        for condition in (0, 1):
            own, other, true = (
                self.gather(side, head["species"], head["quantity"]).of(test.condition == condition)
                for side in sides
            )
            means.append(bootstrap_mean(own, draws))
            intervals[f"condition {condition + 1}"] = means[-1]
            if len(sides[1]):
                shift = bootstrap_difference(own, other, draws)
                intervals[f"{condition + 1} → {2 - condition}"] = shift
            if head["learner"] != RECORDED:
                error = bootstrap_difference(own, true, draws)
                intervals[f"error, condition {condition + 1}"] = error
        intervals["condition 1 − 2"] = subtract(*means)
        rows = []
        for row, value in intervals.items():
            text = paper.get((head["species"], head["learner"], row.partition(",")[0]), "")
            beside = text if head["quantity"] == PATH_LENGTH.key else ""
            rows.append(row_of(value, **head, measure=row, published=beside))
        return rows

    def _truth(self, species: str) -> dict[tuple[str, str], tuple[pd.DataFrame, pd.DataFrame]]:
        """Return what the teams behind the demonstrations do, in their condition and the other."""
        test = self.tests[species]
        if (teams := teams_of(test)) is None:
            return {}
        embodied, acted = teams[0].embody(get_species(species)), []
        for flip in (0, 1):
            parts = []
            for condition in (0, 1):
                rollouts = roll_out_teams(
                    teams,
                    embodied,
                    test,
                    name=TRUTH,
                    seed=SEED,
                    repetitions=5,
                    condition=condition,
                )
                own = test.condition[rollouts.demo] == (condition ^ flip)
                parts.append(measure(rollouts.select(own), test))
            acted.append(pd.concat(parts, ignore_index=True))
        return {(TRUTH, NO_WORLD): (acted[0], acted[1])}

    def _likeness(
        self, species: str, rows: pd.DataFrame, made: Sequence[Record]
    ) -> dict[str, Interval]:
        """Return realism, share reached and DTW distance of the rollouts of some records."""
        draws = Draws.by(np.random.default_rng(SEED))
        return {
            REALISM: mean_over_seeds(np.array([one.about["realism"] for one in made])),
            REACHED: bootstrap_mean(self.gather(rows, species, "captured"), draws, share=True),
            DTW.key: bootstrap_mean(self.gather(rows, species, DTW.key), draws),
        }

    @cached_property
    def departures(self) -> pd.DataFrame:
        """Return what DQDIL-PT does when some of its published settings are changed."""
        rows = []
        settings = {name: setting_of(name) for name in DEPARTURES}
        settings[DEFAULT] = f"{ADAPTED}-{self.scope.departed_steps}"
        for name, (departure, setting) in product(self.tests, settings.items()):
            if not (made := self.of(name, setting, SIMULATED)):
                continue
            own = self.rows(name, setting, SIMULATED)
            head: dict[str, Any] = {"species": name, "departure": departure, "seeds": len(made)}
            intervals = self._likeness(name, own, made) | {
                key: kde_interval(own, self.recorded[name], key)
                for key in (DURATION.key, PATH_LENGTH.key)
            }
            rows += [row_of(value, **head, measure=key) for key, value in intervals.items()]
        return pd.DataFrame(rows, columns=["departure", *COLUMNS])

    @cached_property
    def adapted(self) -> pd.DataFrame:
        """Return realism, verdict, share reached and DTW distance of clones by steps online.

        Gains are over the clone: in realism by training seed, in reaching the target by start.
        """
        rows = []
        settings = [s for s in dict.fromkeys(r[0].setting for r in self.records) if ADAPTED in s]
        for name, setting, learner in product(self.tests, settings, (CLONE, *LEARNERS)):
            if not (made := self.of(name, setting, learner)):
                continue
            own, clone = self.rows(name, setting, learner), (name, f"{ADAPTED}-0", CLONE)
            head: dict[str, Any] = {"species": name, "learner": learner, "seeds": len(made)}
            head["steps"] = int(setting.partition("-")[2])
            head["verdict"] = "; ".join(dict.fromkeys(one.about["verdict"] for one in made))
            intervals = self._likeness(name, own, made)
            before = {one.about["seed"]: one.about["realism"] for one in self.of(*clone)}
            pairs = [(one.about["realism"], before.get(one.about["seed"])) for one in made]
            gains = [later - first for later, first in pairs if first is not None]
            if head["steps"] and gains:
                intervals[GAIN] = mean_over_seeds(np.array(gains))
                its, theirs = (
                    self.gather(one, name, "captured") for one in (own, self.rows(*clone))
                )
                draws = Draws.by(np.random.default_rng(SEED))
                intervals[REACHED_GAIN] = bootstrap_difference(its, theirs, draws, share=True)
            rows += [row_of(value, **head, measure=key) for key, value in intervals.items()]
        return pd.DataFrame(rows, columns=COLUMNS)
