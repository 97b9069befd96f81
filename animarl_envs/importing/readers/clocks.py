"""Columns of times: the frame rate they imply, and the frame each row belongs to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError

UNEVEN = 0.25  # of a frame: how far a time may lie from its frame
LARGEST_FRAME = 2**31


def even_rate(path: Path, time: NDArray[np.float64]) -> float:
    """Frame rate [Hz] of times [s] that must rise evenly from row to row."""
    step = np.diff(time)
    if len(step) == 0 or not np.isfinite(step).all() or not (step > 0).all():
        raise InputError(f"{path}: the times do not rise from row to row: mend them or give --fps")
    usual = float(np.median(step))
    if np.abs(step - usual).max() > 0.5 * usual:
        at = int(np.abs(step - usual).argmax())
        raise InputError(
            f"{path}: the time step at row {at + 2} is {step[at]:.4g} s, not {usual:.4g} s: "
            "fill missing rows, or use a long table with frame numbers"
        )
    return round(1.0 / float(step.mean()), 6)


def refuse_uneven_frames(path: Path, frames: NDArray[np.float64]) -> None:
    """Refuse frame numbers that do not rise by one from row to row."""
    wrong = np.flatnonzero(np.diff(frames) != 1)  # NaN too
    if len(wrong):
        row = int(wrong[0])
        raise InputError(
            f"{path}: row {row + 2} is of frame {frames[row + 1]:g} after {frames[row]:g}: give "
            "every frame in order, or make a long table, where frames may be missing"
        )


def frames_at(
    path: Path, time: NDArray[np.float64], rate: float | None
) -> tuple[float, NDArray[np.int32]]:
    """Frame rate [Hz] and frame number ``(rows,)`` of times [s] in any order, repeats allowed.

    The earliest time is frame 0. Without ``rate`` the median step between different times gives it.
    """
    if not np.isfinite(time).all():
        row = int((~np.isfinite(time)).argmax()) + 1
        raise InputError(f"{path}: row {row} has no time: fill it in, or leave the row out")
    first = float(time.min())
    if rate is None:
        different = np.unique(time)
        if len(different) < 2:
            raise InputError(f"{path}: all rows have the same time: give --option fps=...")
        rate = round(1.0 / float(np.median(np.diff(different))), 6)
    exact = (time - first) * rate
    frames = np.rint(exact)
    off = np.abs(exact - frames)
    if off.max() > UNEVEN or frames.max() >= LARGEST_FRAME:
        row = int(off.argmax()) + 1
        raise InputError(
            f"{path}: the time of row {row} lies between frames at {rate:g} Hz: mend it, or give "
            "the right --option fps=..."
        )
    return rate, frames.astype(np.int32)
