"""Damaged files through every reader: no code runs, no traceback, no silent wrong number.

The damage and the judge are those of ``make fuzz`` (``tools/fuzz``).
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tools.fuzz.judging import assert_true_to_the_file, read_values
from tools.fuzz.layouts import KINDS
from tools.fuzz.mutations import Damage
from tools.fuzz.targets import TARGETS
from tools.fuzz.workers import fuzz

FEW, MANY = 7, 80  # damaged files of each kind in the normal and in the slow run
LOST = Damage(b"", 0)
HARMLESS = {"ran": 0, "traceback": 0, "hang": 0}


def test_readers_withstand_damaged_files() -> None:
    result = fuzz(FEW * len(TARGETS), 1, 7, list(TARGETS))
    assert result.total == FEW * len(TARGETS) >= 200
    assert result.counts.items() >= (HARMLESS | {"unexplained": 0}).items(), result.findings
    assert result.counts["refused"] > result.total / 2


@pytest.mark.slow
def test_readers_withstand_many_damaged_files() -> None:
    result = fuzz(MANY * len(TARGETS), 1, 8, list(TARGETS))
    assert result.total == MANY * len(TARGETS) >= 2000
    assert result.counts.items() >= HARMLESS.items(), result.findings


def test_kinds_have_every_guard() -> None:
    assert {kind.guard for kind in KINDS.values()} == {"checksum", "text", "structure"}


def test_the_judge_notices_what_it_is_there_for(tmp_path: Path) -> None:
    """A reader that returns a number the file does not hold, or shifted ones, is caught."""
    path = KINDS["long"].write(tmp_path)
    clean = read_values(KINDS["long"], path)
    wrong = {key: value.copy() for key, value in clean.items()}
    wrong[next(iter(wrong))][3, 0, 0] += 1e-3
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, wrong, clean, LOST)
    with pytest.raises(AssertionError, match="checksums"):
        assert_true_to_the_file(KINDS["npz"], path, wrong, clean, replace(LOST, overwritten=5))
    with pytest.raises(AssertionError, match="has shifted the numbers"):
        assert_true_to_the_file(KINDS["npy"], path, wrong, clean, LOST)
    assert_true_to_the_file(KINDS["npy"], path, wrong, clean, replace(LOST, overwritten=1))
    shifted: dict[Any, Any] = {key: np.roll(value, 1) for key, value in clean.items()}
    with pytest.raises(AssertionError, match="too many numbers"):
        assert_true_to_the_file(KINDS["npy"], path, shifted, clean, replace(LOST, overwritten=1))
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, shifted, clean, replace(LOST, overwritten=1))
