"""How far the test split is from the others, where that is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from moving_pairs import STARTS, recorded_pairs

from benchmarks.split_floor import split_rows


def test_episodes_that_are_the_same_do_not_differ_and_later_ones_do() -> None:
    same = recorded_pairs().select(episodes=np.tile(np.arange(STARTS // 2), 2))
    half = np.repeat(["test", "train"], STARTS // 2)
    assert all(own == beside for _, own, beside, _ in split_rows(replace(same, split=half)))
    longest = np.argsort(recorded_pairs().lengths)
    by_length = replace(recorded_pairs().select(episodes=longest), split=half)
    found = {label: (own, beside, errors) for label, own, beside, errors in split_rows(by_length)}
    own, beside, errors = found["Duration"]
    assert beside > own
    assert errors > 3
