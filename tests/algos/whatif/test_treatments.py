"""``benchmarks/treatments.py``: the trivial answer, and what its table says of several splits."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from moving_pairs import recorded_pairs

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.whatif.quantities import speeds_of
from animarl_envs.demos.summary import unit_of
from benchmarks.treatments import summary, trivial_shifts


def test_treatments_trivial_answer_is_of_recordings_that_were_learned_from() -> None:
    demos = recorded_pairs()
    condition = np.arange(len(demos)) % 2
    split = np.where(np.arange(len(demos)) < len(demos) // 2, "train", "test")
    demos = replace(demos, condition=condition.astype(demos.condition.dtype), split=split)
    first = f"speed of {demos.individuals[0]}"
    found = trivial_shifts(demos, 1, [first, "turning"])
    speed = speeds_of(Rollouts.from_demonstrations(demos), unit_of(demos).per_arena_unit)[:, 0]
    learned = split == "train"
    expected = speed[learned & (condition == 1)].mean() - speed[learned & (condition == 0)].mean()
    assert found[first] == pytest.approx(expected) and set(found) == {first, "turning"}


def test_treatments_table_counts_splits_whose_interval_holds_the_true_shift() -> None:
    rows = pd.DataFrame({
        "set": "termites", "quantity": "speed", "unit": "mm/s",
        "shift": [-3.0, -1.0], "true": [-2.0, -4.0], "trivial": [-2.5, -2.5],
        "calibrated_low": [-3.5, -2.0], "calibrated_high": [-1.0, 0.0],
        "miss_low": [-2.0, 1.0], "miss_high": [0.5, 5.0],
    })  # fmt: skip
    (found,) = summary(rows).to_dict("records")
    assert found["splits"] == 2 and found["error"] == 2.0
    assert found["error of the trivial answer"] == 1.0
    assert (found["true shift inside"], found["miss holds zero"]) == (0.5, 0.5)
