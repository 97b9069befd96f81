"""The learning curves of a run, from the CSV files that its learners logged."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from animarl_algos.learner.checkpoint import summarise_error
from animarl_envs.errors import InputError


def logged_curves(logs: Path, seed: int) -> pd.DataFrame:
    """All quantities below ``logs``: ``method, phase, seed, step, quantity, value``.

    Raises
    ------
    InputError
        If a table is damaged.
    """
    rows = []
    for file in sorted(logs.glob("*/*/progress.csv")):
        if file.stat().st_size == 0:
            continue
        table = _read_table(file)
        names = [str(column) for column in table]
        offline = [c for c in names if c.startswith("offline/") and c != "offline/epoch"]
        online = [c for c in names if c.startswith(("rollout/", "train/"))]
        phases = (
            ("offline", offline, "offline/epoch"),
            ("online", online, "time/total_timesteps"),
        )
        for phase, columns, step in phases:
            if step not in table:
                continue
            long = table.melt(id_vars=step, value_vars=columns, var_name="quantity")
            long = long.dropna().rename(columns={step: "step"})
            rows.append(long.assign(method=file.parent.parent.name, phase=phase))
    columns = ["method", "phase", "seed", "step", "quantity", "value"]
    if not rows:
        return pd.DataFrame(columns=columns)
    table = pd.concat(rows, ignore_index=True).assign(seed=seed)
    keys = ["method", "phase", "seed", "step", "quantity"]
    return table.drop_duplicates(keys, keep="last")[columns]


def _read_table(file: Path) -> pd.DataFrame:
    try:
        return pd.read_csv(file)
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
        raise InputError(
            f"{file}: the table cannot be read ({summarise_error(error)}): remove it, "
            "or train again"
        ) from None
