"""Damaged files through every reader: no crash, no silent wrong number, no memory beyond bounds.

The damage and the judge are those of ``make fuzz`` (``tools/fuzz``); here each layout is gone
through in this process, and the memory of each file is measured.
"""

from __future__ import annotations

import mmap
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animarl_envs.errors import InputError
from animarl_envs.files import allowed_bytes
from tools.fuzz.judging import assert_is_a_sentence, assert_true_to_the_file, read_values
from tools.fuzz.layouts import KINDS
from tools.fuzz.mutations import Damage, damaged
from tools.fuzz.targets import TARGETS
from tools.fuzz.workers import fuzz as fuzz_in_workers

FEW, MANY = 8, 80  # damaged files of each kind in the normal and in the slow run
LOST = Damage(b"", 0)
STATUS = Path("/proc/self/status")  # of this process, on Linux


class Peak:
    """Resident memory beyond that at the start; nothing where the system does not tell."""

    def __init__(self) -> None:
        self.known = STATUS.exists()
        if self.known:
            (STATUS.parent / "clear_refs").write_text("5")  # the highest mark starts anew
            self.start = self._read("VmRSS")

    def beyond_start(self) -> int:
        return self._read("VmHWM") - self.start if self.known else 0

    @staticmethod
    def _read(name: str) -> int:
        line = next(line for line in STATUS.read_text().splitlines() if line.startswith(name))
        return 1024 * int(line.split()[1])


def fuzz(name: str, folder: Path, count: int) -> tuple[int, int]:
    """Damage one layout ``count`` times; how many files were read and how many refused."""
    kind = KINDS[name]
    path = kind.write(folder)
    targets = [path, *(path.with_name(other) for other in kind.beside)]
    whole = {target: target.read_bytes() for target in targets}
    clean = read_values(kind, path)  # libraries are loaded by now
    allowed = allowed_bytes(max(map(len, whole.values())))
    rng = np.random.default_rng(sum(name.encode()))
    refused = 0
    for number in range(count):
        target = targets[number % len(targets)] if number % 4 == 3 else path
        damage = damaged(whole[target], rng)
        target.write_bytes(damage.data)
        peak = Peak()
        try:
            found = read_values(kind, path)
        except InputError as error:
            assert_is_a_sentence(error)
            refused += 1
        else:
            if target == path:
                assert_true_to_the_file(kind, path, found, clean, damage)
        assert peak.beyond_start() <= allowed, f"file {number}: {peak.beyond_start():,} bytes"
        target.write_bytes(whole[target])
    return count, refused


@pytest.mark.parametrize("name", KINDS)
def test_readers_withstand_damaged_files(name: str, tmp_path: Path) -> None:
    done, refused = fuzz(name, tmp_path, FEW)
    assert done == FEW and refused > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_readers_withstand_many_damaged_files(name: str, tmp_path: Path) -> None:
    done, refused = fuzz(name, tmp_path, MANY)
    assert done == MANY and refused > 0


def test_enough_damaged_files_go_through_the_readers() -> None:
    """200 in the normal run, 2,000 in the slow one; which readers: see test_readers."""
    assert FEW * len(KINDS) >= 200 and MANY * len(KINDS) >= 2000
    assert {kind.guard for kind in KINDS.values()} == {"checksum", "text", "structure"}


@pytest.mark.slow
def test_many_foreign_files_of_all_kinds_do_no_harm() -> None:
    """As ``make fuzz``, in a process with a limit of memory and a watcher."""
    result = fuzz_in_workers(4000, 1, 7, list(TARGETS))
    harmless = {"ran": 0, "crash": 0, "traceback": 0, "slow": 0}
    assert result.total == 4000 and harmless.items() <= result.counts.items(), result.findings


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


def test_memory_is_measured(tmp_path: Path) -> None:
    peak = Peak()
    if not peak.known:
        pytest.skip("this system does not tell a process's highest memory")
    size = 32 * 2**20
    with mmap.mmap(-1, size) as block:  # pages that a heap had not resident
        block.write(b"1" * size)
        assert peak.beyond_start() >= 0.9 * size
