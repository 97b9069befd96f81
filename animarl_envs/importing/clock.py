"""One clock: the frame rate and the frame numbers that a file's times imply, or why there are none.

Times are in seconds, frames are whole numbers. A rate below 1 Hz is kept as a whole period.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.importing.tables import Words

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Place = Callable[[int], str]  # what messages call a row, counted from 0

UNEVEN = 0.25  # of a frame: how far a time may lie from its frame
LARGEST_FRAME = 2**31
CLEARLY = 0.1  # of a frame: how far a step is from whole frames that tells the rate
ROUNDING = 2e-3  # of the rate, which times in whole milliseconds blur
FEW_FRAMES = 3  # steps of more do not tell the rate
IRREGULAR, MANY = 0.01, 20  # share and number of steps off whole frames: fewer are wrong times
LONGEST_STEP = 2.5  # usual steps; longer ones of an irregular clock are gaps
FINE = 5  # roundings in a usual step; fewer do not tell a clock that ticks unevenly
SLOWEST, FASTEST = 0.2, 2000.0  # [Hz] that recordings of animals have
IN_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
CLOCK = r"\d{1,3}:\d{2}:\d{2}(?:[.,]\d+)?"  # hours, minutes, seconds
DECIMAL_COMMA = r",(?=\d+(?:Z|[+-]\d{2}:?\d{2})?$)"


def rate_of_rows(path: Path, time: Floats, place: Place) -> float:
    """Frame rate [Hz] of times [s], of which each row's must be that of the next frame."""
    rate, frames, _ = frames_at(path, time, None, np.zeros(len(time), dtype=np.int64), place)
    refuse_uneven_frames(path, frames, place)
    return rate


def refuse_uneven_frames(
    path: Path, frames: Floats | Whole, place: Place, first: float | None = None
) -> None:
    """Refuse a row that is not the next frame: a gap or a swap would shift time silently."""
    due = np.arange(len(frames)) + (frames[0] if first is None else first)
    wrong = np.flatnonzero(frames != due)  # NaN too
    if len(wrong):
        row = int(wrong[0])
        raise InputError(
            f"{path}: {place(row)} is of frame {frames[row]:g}, not {due[row]:g}: give every frame "
            "in order, with empty cells where nothing was tracked"
        )


def frames_at(
    path: Path, time: Floats, rate: float | None, group: Whole, place: Place
) -> tuple[float, Whole, Floats]:
    """Frame rate [Hz] and frame number ``(rows,)`` of times [s], and the first time of each group.

    The earliest time of each ``group`` is frame 0. Without ``rate`` the steps between different
    times give it: the median, made exact by all steps of few frames, whole where that fits.
    """
    if not np.isfinite(time).all():
        row = int((~np.isfinite(time)).argmax())
        raise InputError(f"{path}: {place(row)} has no time: fill it in, or leave the row out")
    first = np.full(int(group.max()) + 1, np.inf)
    np.minimum.at(first, group, time)
    since = time - first[group]
    if rate is None:
        before, after = _neighbours(group, since)
        step = since[after] - since[before]
        step = step[step > 0]
        if len(step) == 0:
            raise InputError(f"{path}: all rows have the same time: give --option fps=...")
        usual = float(np.median(step))
        frames = np.rint(step / usual)
        few = (frames >= 1) & (frames <= FEW_FRAMES)
        few &= np.abs(step / usual - frames) < CLEARLY + 1.01 * rounding(time) / usual
        exact = round(float(frames[few].sum() / step[few].sum()), 6)
        whole = [float(round(exact))] if abs(round(exact) - exact) < ROUNDING * exact else []
        rates = [*whole, exact]
    else:
        rates = [rate]
    for rate in rates:
        numbers = np.rint(since * rate)
        off = np.abs(since * rate - numbers)
        if rate > 0 and off.max() <= UNEVEN and numbers.max() < LARGEST_FRAME:
            return rate, numbers.astype(np.int64), first
    raise InputError(
        f"{path}: the time of {place(int(off.argmax()))} lies between frames at {rate:g} Hz: "
        "correct it, or give the right --option fps=..."
    )


def rounding(time: Floats) -> float:
    """To which power of ten times [s] are rounded, a microsecond at least."""
    kept = (digits for digits in range(6) if np.abs(time - time.round(digits)).max() < 1e-7)
    return float(10.0 ** -next(kept, 6))


def irregular_rate(path: Path, time: Floats, track: Whole) -> float | None:
    """The usual rate [Hz] of a clock that ticks unevenly; None where it ticks evenly."""
    before, after = _neighbours(track, time)
    step = time[after] - time[before]
    if len(step) == 0 or not (step > 0).all():
        return None
    usual = float(np.median(step))
    off = np.count_nonzero(np.abs(step / usual - np.rint(step / usual)) > UNEVEN)
    if off < max(MANY, IRREGULAR * len(step)):
        return None
    if usual < FINE * rounding(time):
        raise InputError(
            f"{path}: its times are rounded to {rounding(time):g} s, too coarsely for frames about "
            f"{usual:.3g} s apart: write them with more digits, or add a column of frame numbers"
        )
    return float(f"{1.0 / usual:.3g}")


def even_rows(time: Floats, track: Whole, rate: float) -> tuple[Whole, Whole, Floats, Floats]:
    """Rows around each tick of an even clock, the share of the way between them, and its time [s].

    Ticks are whole multiples of ``1 / rate``; those in a gap are left out.
    """
    before, after = _neighbours(track, time)
    tick = np.ceil(time * rate - 1e-9).astype(np.int64)  # the first one that is not before
    near = time[after] - time[before] <= LONGEST_STEP / rate
    count = np.where(near, tick[after] - tick[before], 0)
    low, high = np.repeat(before, count), np.repeat(after, count)
    number = np.arange(len(low)) - np.repeat(np.cumsum(count) - count, count)
    ticks = (tick[low] + number) / rate
    return low, high, (ticks - time[low]) / (time[high] - time[low]), ticks


def _neighbours(group: Whole, *keys: Floats | Whole) -> tuple[Whole, Whole]:
    """Rows and those right after them in the same group, sorted by keys, else as they stand."""
    order: Whole = np.lexsort((*keys, group))
    same = np.diff(group[order]) == 0
    return order[:-1][same], order[1:][same]


def refuse_times_going_back(path: Path, time: Floats, track: Whole, place: Place) -> None:
    """Refuse times [s] that are earlier than those of the same ``track`` on a line above.

    Clock times do so at midnight, and when daylight saving time ends. Sorted, they would be frames
    that lie hours apart.
    """
    before, after = _neighbours(track)
    back = after[time[after] < time[before]]
    if len(back):
        raise InputError(
            f"{path}: the time of {place(int(back.min()))} is earlier than the one before of the "
            "same individual (past midnight, or daylight saving?): write times that rise, or sort "
            "the rows by time"
        )


def rate_of_frames(path: Path, frames: Whole, time: Floats, group: Whole) -> float:
    """Frame rate [Hz] of rows that have a frame number and a time [s] each.

    All frames over all time, since single steps of rounded times are too long or too short; without
    steps that even rounding does not explain, as of a paused camera.
    """
    before, after = _neighbours(group, frames)
    steps, passed = frames[after] - frames[before], time[after] - time[before]
    use = (steps > 0) & (passed > 0)
    if not use.any():
        raise InputError(f"{path}: its times do not rise with its frames: give --option fps=...")
    usual, digit = float(np.median(passed[use] / steps[use])), rounding(time)
    use = (steps > 0) & (passed >= 0)
    use &= np.abs(passed - usual * steps) <= UNEVEN * usual * steps + 1.01 * digit
    count, lasted = int(steps[use].sum()), float(passed[use].sum())
    whole = max(round(count / lasted), 1)
    fits = abs(count / whole - lasted) <= digit * (int(group.max()) + 1)
    return float(whole) if fits else round(count / lasted, 6)


def seconds(path: Path, column: str, values: Floats | Words, unit: str | None) -> Floats:
    """Return times in seconds: numbers of a unit, ISO 8601 dates, or clock times: 0:01:02.5."""
    if not isinstance(values, Words):
        if (unit or "s") not in IN_SECONDS:
            raise InputError(
                f"{path}: times in {unit!r} are unknown: choose one of {', '.join(IN_SECONDS)}"
            )
        return np.asarray(values * IN_SECONDS[unit or "s"])
    import pandas

    texts = pandas.Series(values.entries, dtype=str).str.replace(DECIMAL_COMMA, ".", regex=True)
    try:
        if texts.str.fullmatch(CLOCK).all():
            passed = pandas.to_timedelta(texts)
        else:
            moments = pandas.to_datetime(texts, format="ISO8601", utc=True)
            passed = moments - moments.min().normalize()  # since midnight: more digits than 1970
        return np.asarray(passed.dt.total_seconds(), dtype=np.float64)[values.number]
    except (ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: column {column!r} holds times that are neither ISO 8601, such as "
            f"2024-05-01 10:00:00.25, nor hours:minutes:seconds ({str(error)[:100]}): rewrite "
            "them, or use a column of seconds"
        ) from None


def check_rate(path: Path, column: str, rate: float) -> None:
    """Refuse times of no stated unit that can hardly be seconds."""
    if not SLOWEST <= rate <= FASTEST:
        raise InputError(
            f"{path}: the times of column {column!r} would make {rate:.4g} frames a second if they "
            "were seconds: say what they are by --option time_unit=ms (or us, min, s)"
        )
