"""Rows of a table that cannot be placed are refused: odd frames, two of one cell, a late frame."""

import math

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError, refuse_rows, require
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing.clock import LARGEST_FRAME
from animarl_envs.importing.tables import Table

SPARSE, SMALL = 100, 2**20  # cells of frame and individual: so many a row, and in all


def frame_numbers(table: Table, column: str, frames: Floats) -> Ints:
    """Return frames as whole numbers; refuse others."""
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < LARGEST_FRAME))
    refuse_rows(
        np.flatnonzero(bad).tolist(),
        lambda row: (
            f"{table.path}: {table.place(row)}, column {column!r} holds {frames[row]:g}: give "
            "whole numbers from 0"
        ),
    )
    return frames.astype(np.int64)


def refuse_two_rows(
    table: Table,
    recording: str,
    cell: Ints,
    individuals: list[str],
    rows: Ints,
    first: int = 0,
) -> None:
    """Refuse a second row of one frame and individual; ``rows`` are those of the table."""
    twice = np.flatnonzero(np.bincount(cell) > 1)
    if len(twice):
        individual = int(twice[0]) % len(individuals)
        second = int(np.flatnonzero(cell == twice[0])[1])
        before = cell[:second][cell[:second] % len(individuals) == individual]
        require(
            before.max() == twice[0],
            f"{table.path}: frames begin again at {table.place(int(rows[second]))}, as of a second "
            "session or animal: rename the column that tells them apart recording or animal, or "
            "split the file",
        )

        def name_place(of: int) -> str:
            frame, individual = divmod(of, len(individuals))
            return (
                f"{table.path}: {recording}, frame {first + frame}, {individuals[individual]} has "
                "two rows: drop the duplicate, or name the recording column"
            )

        refuse_rows(twice.tolist(), name_place)


def is_sparse(frames: Ints, recording: Ints, individuals: int) -> bool:
    """Return whether few of the frames hold a row, as in a film of short visits."""
    first = np.full(int(recording.max()) + 1, LARGEST_FRAME)
    last = np.zeros_like(first)
    np.minimum.at(first, recording, frames)
    np.maximum.at(last, recording, frames)
    cells = int((last - first + 1).max()) * individuals
    return individuals > 1 and cells > max(SPARSE * len(frames), SMALL)


def check_extent(
    table: Table, recording: str, shape: tuple[int, ...], frames: Ints, rows: Ints
) -> None:
    """Refuse a frame so late that the recording would take more memory than the file may ask."""
    size = math.prod(shape) * 16
    if size > allowed_bytes(table.path.stat().st_size):
        last = int(frames.argmax())
        raise InputError(
            f"{table.path}: {table.place(int(rows[last]))} is of frame {frames[last]}, with which "
            f"recording {recording} would take {size / 2**20:,.0f} MiB, more "
            f"than {EXPANSION} times the file: correct it"
        )
