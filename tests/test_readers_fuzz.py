"""Damaged files through every reader: no crash, no silent wrong number, no memory beyond bounds.

Files are cut, lose a piece, have one repeated, or have bytes overwritten, at their start above all.
What a reader still returns is judged by what can show damage in that layout, see ``Kind.guard``:
checksummed values must be the original ones; text must read the same to a second parser (Python's
``csv``); raw numbers without checksum may differ only where a byte was overwritten.
"""

from __future__ import annotations

import csv
import math
import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_envs.demos import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.importing.readers import get_reader, read, read_tracks
from animarl_envs.importing.readers.guards import ALLOWANCE, EXPANSION
from animarl_envs.importing.tracks import Tracks
from tools.fuzz.layouts import KINDS, Kind

FEW, MANY = 8, 80  # damaged files of each kind in the normal and in the slow run
PACKED = 3  # numbers that share a byte, where a table stores places in a list of values
HEAD = 512  # headers lie at the start [bytes]
STATUS = Path("/proc/self/status")  # of this process, on Linux

NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*")


@dataclass(frozen=True)
class Damage:
    """Bytes after the damage, and how many were overwritten (0: lost, repeated or cut off)."""

    data: bytes
    overwritten: int


def damaged(raw: bytes, rng: np.random.Generator) -> Damage:
    data, how = bytearray(raw), rng.integers(5)
    place = int(rng.integers(1, len(data)))
    if how == 0:
        return Damage(bytes(data[:place]), 0)
    if how == 1:
        start = int(rng.integers(place))
        return Damage(bytes(data[:place] + data[start:place] + data[place:]), 0)
    if how == 2:
        return Damage(bytes(data[:place] + data[place + int(rng.integers(1, 64)) :]), 0)
    count = 1 if how == 3 else int(rng.integers(1, 40))
    reach = len(data) if rng.random() < 0.5 else min(len(data), HEAD)
    for at in rng.integers(reach, size=count):
        data[at] = rng.integers(256)
    return Damage(bytes(data), count)


Values = dict[tuple[str, str], NDArray[np.float64]]  # by recording and individual


def values_of(found: Demonstrations | list[Tracks]) -> Values:
    if isinstance(found, Demonstrations):
        return {("", name): found.positions[:, i] for i, name in enumerate(found.individuals)}
    return {
        (tracks.recording, name): tracks.positions[:, i]
        for tracks in found
        for i, name in enumerate(tracks.individuals)
    }


def read_values(kind: Kind, path: Path) -> Values:
    """What the reader returns, after a passage through the whole import as well."""
    if get_reader(kind.source).read_tracks is None:
        return values_of(read(path, kind.source))
    found = values_of(read_tracks(path, kind.source))
    try:
        demos = read(path, kind.source, frame_rate=25.0)
    except InputError as error:
        assert_is_a_sentence(error)
    else:
        assert np.isfinite(demos.positions).all() and (demos.lengths >= 2).all()
    return found


def assert_is_a_sentence(error: InputError) -> None:
    assert str(error) and "\n" not in str(error)


def same(one: Values, other: Values) -> bool:
    return one.keys() == other.keys() and all(
        np.array_equal(one[key], other[key], equal_nan=True) for key in one
    )


def assert_true_to_the_file(kind: Kind, path: Path, found: Values, clean: Values, by: int) -> None:
    """``found`` is what the damaged file holds; ``by`` bytes of it were overwritten."""
    if same(found, clean):
        return
    assert kind.guard != "checksum", "other numbers than those that the checksums are of"
    if kind.guard == "text":
        rows = second_reading(path)
        long = {(row[0], *pair) for row in rows for pair in pairwise(row[1:])}
        for (_, name), positions in found.items():
            for t, _, (x, y) in entries(positions):
                there = (t, x, y) in long if kind.source == "long-table" else x_y_in(rows[t], x, y)
                assert there, f"{name}, frame {t}: {x!r}, {y!r} is not in the file"
        return
    assert by > 0, "a piece that was lost or repeated has shifted the numbers"
    for key in found.keys() & clean.keys():
        if found[key].shape == clean[key].shape:
            other = np.isfinite(found[key]) & (found[key] != clean[key])
            assert np.count_nonzero(other) <= PACKED * by, f"{key}: too many numbers have changed"


def second_reading(path: Path) -> list[list[float]]:
    """The rows of a text table that hold numbers, by another parser and strictly."""
    found = []
    delimiter = "\t" if path.suffix == ".tsv" else ","
    with path.open(newline="", encoding="utf-8-sig") as file:
        for row in csv.reader(file, delimiter=delimiter):
            numbers = [float(cell) if NUMBER.fullmatch(cell) else math.nan for cell in row]
            if not all(map(math.isnan, numbers)):
                found.append(numbers)
    return found


def entries(positions: NDArray[np.float64]) -> Iterator[tuple[int, int, tuple[float, float]]]:
    """Frame, keypoint, x and y wherever both are known."""
    for t, k in np.argwhere(np.isfinite(positions).all(axis=2)).tolist():
        x, y = positions[t, k].tolist()
        yield t, k, (x, y)


def x_y_in(row: list[float], x: float, y: float) -> bool:
    """Up to the last bit, in which the parser that movement uses may err."""
    return any(
        math.isclose(x, a, rel_tol=1e-15) and math.isclose(y, b, rel_tol=1e-15)
        for a, b in pairwise(row)
    )


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
    allowed = EXPANSION * max(map(len, whole.values())) + ALLOWANCE
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
                assert_true_to_the_file(kind, path, found, clean, damage.overwritten)
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


def test_the_judge_notices_what_it_is_there_for(tmp_path: Path) -> None:
    """A reader that returns a number the file does not hold, or shifted ones, is caught."""
    path = KINDS["long"].write(tmp_path)
    clean = read_values(KINDS["long"], path)
    wrong = {key: value.copy() for key, value in clean.items()}
    wrong[next(iter(wrong))][3, 0, 0] += 1e-3
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, wrong, clean, 0)
    with pytest.raises(AssertionError, match="checksums"):
        assert_true_to_the_file(KINDS["npz"], path, wrong, clean, 5)
    with pytest.raises(AssertionError, match="has shifted the numbers"):
        assert_true_to_the_file(KINDS["npy"], path, wrong, clean, 0)
    assert_true_to_the_file(KINDS["npy"], path, wrong, clean, 1)
    shifted: dict[Any, Any] = {key: np.roll(value, 1) for key, value in clean.items()}
    with pytest.raises(AssertionError, match="too many numbers"):
        assert_true_to_the_file(KINDS["npy"], path, shifted, clean, 1)
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, shifted, clean, 1)


def test_memory_is_measured(tmp_path: Path) -> None:
    peak = Peak()
    if not peak.known:
        pytest.skip("this system does not tell a process's highest memory")
    size = 32 * 2**20
    with mmap.mmap(-1, size) as block:  # pages that a heap had not resident
        block.write(b"1" * size)
        assert peak.beyond_start() >= 0.9 * size
