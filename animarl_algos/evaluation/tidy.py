"""Tidy tables as files: CSV and Parquet, with a reason wherever a value is undefined."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_envs.errors import MissingExtraError
from animarl_envs.files import write_then_rename

if TYPE_CHECKING:
    import pandas as pd


def write_tables(tables: Mapping[str, pd.DataFrame], folder: str | Path) -> None:
    """Every table that has columns as ``NAME.csv`` and ``NAME.parquet``, whole or not at all.

    Their column ``reason`` says why a number of the row is missing; reasons that a table has
    already are kept.

    Raises
    ------
    InputError
        If a file cannot be written.
    MissingExtraError
        If pyarrow is not installed.
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
    if not missing:
        return ""
    found = []
    if "kde_null" in row:
        if row["rollouts"] == 0:
            return "no episode counts: the target was never reached"
        metric = next((m for m in METRICS if m.key == row["metric"]), None)
        if row["method"] == RECORDED:
            found.append("recordings are what is compared with")
        elif metric is not None and not metric.of_recordings:
            found.append("it is itself a distance to the recordings")
        elif metric is not None and metric.share:
            found.append("a share has no distribution")
        if {"mean_low", "to_recorded_low", "kde_low"} & set(missing) and row["demos"] < 2:
            found.append("one demonstration gives no interval")
        if (not found and "within" in missing) or (not found and "within_low" in missing):
            found.append("a single method has no other to be compared with within starts")
    return "; ".join(found) or f"not defined with so few values: {', '.join(missing)}"
