"""What a reader still returns of a damaged file, judged by what can show damage in that layout.

Checksummed values must be the original ones; text must read the same to a second parser (Python's
``csv``); raw numbers without checksum may differ only where a byte was overwritten.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.importing.readers import get_reader, read, read_tracks
from animarl_envs.importing.tracks import Tracks
from tools.fuzz.layouts import Kind
from tools.fuzz.mutations import Damage

PACKED = 3  # numbers that share a byte, where a table stores places in a list of values
NUMBER = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*")
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
    if get_reader(kind.source).finished:
        return values_of(read(path, kind.source))
    found = values_of(read_tracks(path, kind.source))
    try:
        demos = read(path, kind.source, frame_rate=25.0)
    except InputError as error:
        assert_is_a_sentence(error)
    else:
        assert np.isfinite(demos.positions).all() and (demos.lengths >= 2).all()
    return found


FRAME_COLUMNS = {"long-table": 0, "deeplabcut": 0, "trex": 0, "sleap": 1}  # others: row by row
ETHOVISION = "Number of header lines:"  # the first cell of its header, before a number


def assert_is_a_sentence(error: InputError) -> None:
    assert str(error) and "\n" not in str(error)


def same(one: Values, other: Values) -> bool:
    return one.keys() == other.keys() and all(
        np.array_equal(one[key], other[key], equal_nan=True) for key in one
    )


def assert_true_to_the_file(
    kind: Kind, path: Path, found: Values, clean: Values, damage: Damage
) -> None:
    """``found`` is what the damaged file holds."""
    if same(found, clean):
        return
    guard = "structure" if damage.sealed and kind.guard == "checksum" else kind.guard
    assert guard != "checksum", "other numbers than those that the checksums are of"
    if guard == "text":
        rows = second_reading(path)
        frame = FRAME_COLUMNS.get(kind.source)
        named = {
            (row[frame], *pair)
            for row in rows
            if frame is not None and len(row) > frame
            for pair in pairwise(row[frame + 1 :])
        }
        for (_, name), positions in found.items():
            for t, _, (x, y) in entries(positions):
                there = (t, x, y) in named if named else x_y_in(rows[t], x, y)
                assert there, f"{name}, frame {t}: {x!r}, {y!r} is not in the file"
        return
    assert damage.overwritten > 0, "a piece that was lost or repeated has shifted the numbers"
    for key in found.keys() & clean.keys():
        if found[key].shape == clean[key].shape:
            other = np.isfinite(found[key]) & (found[key] != clean[key])
            changed = np.count_nonzero(other)
            assert changed <= PACKED * damage.overwritten, f"{key}: too many numbers have changed"


def second_reading(path: Path) -> list[list[float]]:
    """The rows of a text table that hold numbers, by another parser and strictly."""
    found = []
    delimiter = "\t" if path.suffix == ".tsv" else ","
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        for row in csv.reader(file, delimiter=delimiter):
            numbers = [float(cell) if NUMBER.fullmatch(cell) else math.nan for cell in row]
            if row[:1] != [ETHOVISION] and not all(map(math.isnan, numbers)):
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
