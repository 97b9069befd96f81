"""The data sets of ``benchmarks/faithful.py``: those that are packaged can be dealt as they say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from animarl_envs.demos.splits import cross_validated
from benchmarks.faithful import SETS, DataSet

CROSSED = [one for one in SETS if one.importing is None and one.folds > 1]


@pytest.mark.parametrize("one", CROSSED, ids=[one.name for one in CROSSED])
def test_every_episode_is_tested_once(one: DataSet, tmp_path: Path) -> None:
    demos = one.load(tmp_path)
    tested = [np.flatnonzero(fold.split == "test") for fold in cross_validated(demos, one.folds)]
    assert len(tested) == one.folds
    assert np.sort(np.concatenate(tested)).tolist() == list(range(len(demos)))
