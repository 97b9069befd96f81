"""A whole evaluation, rollouts of several methods against recordings, and its tables as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.classifier import Tracked
from animarl_algos.evaluation.comparison import (
    comparison_table,
    factual,
    pair_table,
)
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.evaluation.verdict import Verdict, read_table, verdict
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import write_then_rename

if TYPE_CHECKING:
    import pandas as pd

TABLES = ("metrics", "comparison", "pairs")
NUMBERS = ("fingerprint", "seed", "resamples")


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """The tables of an evaluation, each a tidy data frame, and the verdict on one method.

    ``metrics`` has one row per rollout and recording, ``comparison`` one per method, metric and
    counting rule, ``pairs`` one per ordered pair of methods.
    ``fingerprint`` is that of the evaluated demonstrations.
    """

    metrics: pd.DataFrame
    comparison: pd.DataFrame
    pairs: pd.DataFrame
    verdict: Verdict
    fingerprint: str
    seed: int
    resamples: int

    def save(self, folder: str | Path) -> Path:
        """Write a CSV per table, the verdict and ``evaluation.json``, each whole or not at all."""
        folder = Path(folder)
        for name in TABLES:
            with write_then_rename(folder / f"{name}.csv") as part:
                getattr(self, name).to_csv(part, index=False)
        self.verdict.save(folder)
        with write_then_rename(folder / "evaluation.json") as part:
            part.write_text(
                json.dumps({key: getattr(self, key) for key in NUMBERS}, indent=2) + "\n"
            )
        return folder

    @classmethod
    def load(cls, folder: str | Path) -> Evaluation:
        """Read what :meth:`save` wrote, or raise InputError if a file is missing or damaged."""
        folder = Path(folder)
        try:
            numbers = json.loads((folder / "evaluation.json").read_text())
            tables: dict[str, Any] = {n: read_table(folder / f"{n}.csv") for n in TABLES}
            return cls(**tables, **numbers, verdict=Verdict.load(folder))
        except FileNotFoundError as error:
            raise InputError(
                f"{folder}: {Path(error.filename).name} is missing: evaluate the run again"
            ) from None
        except (ValueError, TypeError) as error:
            raise InputError(
                f"{folder}: the evaluation is damaged ({error}): evaluate the run again"
            ) from error


def evaluate(
    rollouts: Mapping[str, Rollouts],
    demos: Demonstrations,
    *,
    seed: int,
    learner: str | None = None,
    floor: Tracked | None = None,
    references: Demonstrations | None = None,
    smoothing: int | None = None,
    resamples: int = RESAMPLES,
) -> Evaluation:
    """Measure and compare the rollouts of several methods.

    Parameters
    ----------
    rollouts
        By method name, all its seeds and cues joined.
    demos
        The evaluated demonstrations, which the rollouts started from.
    seed
        Of the resampling.
    learner
        The method that the verdict is about; the first by default.
    floor, references, smoothing
        See :func:`~animarl_algos.evaluation.verdict.verdict`.
    """
    import pandas as pd

    if not rollouts:
        raise InputError("there are no rollouts to evaluate: collect those of one method at least")
    learner = learner or next(iter(rollouts))
    if learner not in rollouts:
        raise InputError(
            f"there are no rollouts of {learner!r}: choose one of {', '.join(rollouts)}"
        )
    tables = [measure_recordings(demos)]
    tables += [measure(r, demos).assign(method=name) for name, r in rollouts.items()]
    metrics = pd.concat(tables, ignore_index=True)
    compared = set(factual(metrics)["method"])
    for name in rollouts:
        if name not in compared:
            raise InputError(
                f"no rollout of {name!r} is in the condition of its recording: collect them with "
                "condition='demo' and the actual cue"
            )
    streams = np.random.default_rng(seed).spawn(4)
    number = demos.num_episodes
    return Evaluation(
        metrics=metrics,
        comparison=comparison_table(metrics, number, streams[0], resamples=resamples),
        pairs=pair_table(metrics, number, streams[3], resamples=resamples),
        verdict=verdict(
            demos,
            replace(rollouts[learner], method=learner),
            seed=seed,
            floor=floor,
            baselines={name: r for name, r in rollouts.items() if name != learner},
            references=references,
            smoothing=smoothing,
        ),
        fingerprint=demos.fingerprint(),
        seed=seed,
        resamples=resamples,
    )


def write_tables(tables: Mapping[str, pd.DataFrame], folder: str | Path) -> None:
    """Every table that has columns as ``NAME.csv`` and ``NAME.parquet``, whole or not at all.

    Their column ``reason`` says why a number of the row is missing; reasons that a table has
    already are kept. MissingExtraError if pyarrow is not installed.
    """
    for name, table in tables.items():
        if not len(table.columns):
            continue
        given = table["reason"].fillna("") if "reason" in table else [""] * len(table)
        reasons = [str(own) or _reason(row) for own, (_, row) in zip(given, table.iterrows())]
        tidy = table.assign(reason=reasons)
        with write_then_rename(Path(folder) / f"{name}.csv") as part:
            tidy.to_csv(part, index=False)
        with write_then_rename(Path(folder) / f"{name}.parquet") as part:
            try:
                tidy.to_parquet(part, index=False, engine="pyarrow")
            except ImportError as error:
                raise MissingExtraError("writing Parquet", "algos") from error


def _reason(row: Any) -> str:
    """Why values of a row are missing, where it does not say so itself."""
    missing = [key for key, value in row.items() if isinstance(value, float) and np.isnan(value)]
    return f"not defined with so few values: {', '.join(missing)}" if missing else ""
