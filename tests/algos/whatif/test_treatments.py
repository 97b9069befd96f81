"""``benchmarks/treatments.py``: what its table says of several splits."""

import pandas as pd

from benchmarks.treatments import summary, totals


def test_treatments_table_counts_splits_whose_interval_holds_the_true_shift() -> None:
    rows = pd.DataFrame({
        "set": "termites", "quantity": "speed", "unit": "mm/s",
        "shift": [-3.5, -1.5], "true": [-2.0, -4.0], "trivial": [-2.5, -2.5],
        "calibrated": [-3.0, -1.0],
        "calibrated_low": [-3.5, -2.0], "calibrated_high": [-1.0, 0.0],
        "low": [-3.1, -1.1], "high": [-2.9, -0.9],
        "true_low": [-2.2, -4.5], "true_high": [-1.8, -3.5],
    })  # fmt: skip
    (found,) = summary(rows).to_dict("records")
    assert found["splits"] == 2 and found["error"] == 2.0
    assert found["error of the trivial answer"] == 1.0 and found["nearer"] == 0
    assert found["error of the simulated shift"] == 2.0
    assert found["covered"] == found["strictly"] == 0.5
    assert found["by the plain interval"] == 0.0
    assert totals(summary(rows)) == (
        "Of 2 rows 1 are covered, 1 strictly, 0 by the plain interval, and in 0 the prediction is "
        "nearer than the trivial answer. Of 1 mean errors 0 are smaller than the trivial answer's, "
        "and 0 than those of the simulated shift."
    )
