"""Tables of metrics with given values, and single rows of what is made of them."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray


def metrics_rows(
    method: str, seed: int, value: NDArray[np.float64], captured: NDArray[np.bool_], **more: object
) -> pd.DataFrame:
    """One row per demonstration with every metric equal to ``value``."""
    count = len(value)
    names = ("path_length", "duration", "dtw", "dtw_per_step")
    columns: dict[str, object] = {"method": method, "seed": seed, "demo": np.arange(count)}
    columns |= {
        "repetition": 0,
        "condition": 0,
        "cue": -1,
        "outcome": 0,
        "captured": captured,
        "factual": True,
    }
    columns |= {"reached": captured.astype(float), **dict.fromkeys(names, value), **more}
    return pd.DataFrame(columns)


def joined_rows(*given: tuple[object, ...]) -> pd.DataFrame:
    """Rows of several methods and seeds, each as :func:`metrics_rows` takes them."""
    return pd.concat([metrics_rows(*one) for one in given])  # type: ignore[arg-type]


def row(table: pd.DataFrame, **where: object) -> pd.Series:
    chosen = table
    for key, value in where.items():
        chosen = chosen[chosen[key] == value]
    assert len(chosen) == 1
    return chosen.iloc[0]
