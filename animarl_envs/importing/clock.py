"""The frame rate and the frame numbers that follow from the times of a file.

Times are in seconds, frames are whole numbers. Above 1 Hz a rate is whole where that fits, below it
the period is. Times of no stated unit are not taken for seconds where no camera is so slow or fast.
"""

import shlex
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError, refuse_rows
from animarl_envs.importing.tables import TextColumn

Place = Callable[[int], str]  # what messages call a row, counted from 0

UNEVEN = 0.25  # of a frame: how far a time may lie from its frame
LARGEST_FRAME = 2**31
MAX_OFF_WHOLE = 0.1  # of a frame: how far a step is from whole frames that tells the rate
ROUNDING = 2e-3  # of the rate, which times in whole milliseconds blur
FEW_FRAMES = 3  # steps of more do not tell the rate
PAUSES = 0.5  # share of steps from frame to frame that may take another time, as of a paused camera
IRREGULAR_SHARE, MIN_IRREGULAR_STEPS = 0.01, 20  # of steps off whole frames; fewer are mistakes
LONGEST_STEP = 2.5  # usual steps; longer ones of an irregular clock are gaps
MIN_ROUNDINGS_PER_STEP = 5  # fewer cannot show that a clock ticks unevenly
SLOWEST, FASTEST = 1.0, 500.0  # [Hz] of nearly all cameras; 1 Hz itself is of frame numbers
IN_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}
CLOCK = r"\d{1,3}:\d{2}:\d{2}(?:[.,]\d+)?"  # hours, minutes, seconds
DECIMAL_COMMA = r",(?=\d+(?:Z|[+-]\d{2}:?\d{2})?$)"


@dataclass(frozen=True)
class Clock:
    """The clock of a table's rows.

    ``rate`` is in Hz, ``frames`` are the frame numbers of the rows, ``first`` the time of frame 0
    of each group [s]. ``residual`` is how far times lie from their frames at most, in frames.
    """

    rate: float
    frames: Ints
    first: Floats
    residual: float


def fit_clock(
    path: Path,
    time: Floats,
    group: Ints,
    place: Place,
    frames: Ints | None = None,
    rate: float | None = None,
    unsaid: str | None = None,
    unit: float = 1.0,
) -> Clock:
    """Return the frame rate and the frames of rows by their times [s]; refuse uneven times.

    Without ``frames`` the earliest time of each ``group`` is frame 0, and without ``rate`` the
    usual step between times gives it. ``unsaid`` is the column of times of no stated unit, ``unit``
    that in which they were written [s].
    """
    refuse_rows(
        np.flatnonzero(~np.isfinite(time)).tolist(),
        lambda row: f"{path}: {place(row)} has no time: fill it in, or leave the row out",
    )
    first = np.zeros(int(group.max()) + 1)
    digit = rounding(time, unit)
    if frames is not None:
        rate, residual = _rate_of_frames(path, frames, time, group, place, digit)
        _check_unit(path, unsaid, rate, True)
        return Clock(rate, frames, first, residual)
    first += np.inf
    np.minimum.at(first, group, time)
    since = time - first[group]
    rates = _rates_of_steps(path, since, group, digit)
    _check_unit(path, unsaid, rates[0], False)
    for tried in rates if rate is None else [rate]:
        numbers = np.rint(since * tried)
        off = np.abs(since * tried - numbers)
        if tried > 0 and off.max() <= UNEVEN and numbers.max() < LARGEST_FRAME:
            return Clock(tried, numbers.astype(np.int64), first, float(off.max()))
    worst = np.flatnonzero(off >= min(UNEVEN, float(off.max())))
    refuse_rows(
        worst[np.argsort(-off[worst], kind="stable")].tolist(),
        lambda row: (
            f"{path}: the time of {place(row)} lies between frames at {tried:g} Hz: correct it, or "
            "give the right --option fps=..."
        ),
    )
    raise AssertionError


def rate_of_rows(path: Path, time: Floats, place: Place) -> float:
    """Return the frame rate [Hz] of times [s]; each row must be the next frame."""
    clock = fit_clock(path, time, np.zeros(len(time), dtype=np.int64), place)
    refuse_uneven_frames(path, clock.frames, place)
    return clock.rate


def _rates_of_steps(path: Path, since: Floats, group: Ints, digit: float) -> list[float]:
    """Return rates [Hz] by the median step, made exact by all steps of few frames.

    The first is whole, or of a whole period, where that fits.
    """
    before, after = _neighbours(group, since)
    step = since[after] - since[before]
    step = step[step > 0]
    if len(step) == 0:
        raise InputError(f"{path}: all rows have the same time: give --option fps=...")
    usual = float(np.median(step))
    frames = np.rint(step / usual)
    few = (frames >= 1) & (frames <= FEW_FRAMES)
    few &= np.abs(step / usual - frames) < MAX_OFF_WHOLE + 1.01 * digit / usual
    exact = float(frames[few].sum() / step[few].sum())
    whole = _whole(exact)
    fits = abs(whole - exact) < ROUNDING * exact
    return [*[whole] * fits, _rounded(exact)]


def _rate_of_frames(
    path: Path, frames: Ints, time: Floats, group: Ints, place: Place, digit: float
) -> tuple[float, float]:
    """Return the frame rate [Hz] of rows with a frame number and a time [s] each, and the residual.

    A line through all frames with a new time gives it, since single steps of rounded times are too
    long or too short. Steps that even rounding does not explain, as of a paused camera, cut it.
    """
    before, after = _neighbours(group, frames)
    steps, passed = frames[after] - frames[before], time[after] - time[before]
    back = (steps > 0) & (passed < 0)
    refuse_rows(
        np.sort(after[back]).tolist(),
        lambda row: (
            f"{path}: the time of {place(row)} is earlier than that of the frame before: correct "
            "it, or give --option fps=... to count frames alone"
        ),
    )
    rising = (steps > 0) & (passed > 0)
    if not rising.any():
        raise InputError(f"{path}: its times do not rise with its frames: give --option fps=...")
    usual = float(np.median(passed[rising] / steps[rising]))
    off = np.maximum(np.abs(passed - usual * steps) - 1.01 * digit, 0.0)
    even = off <= UNEVEN * usual * steps
    use = even & (steps > 0)
    count, lasted = int(steps[use].sum()), float(passed[use].sum())
    if lasted <= 0 or np.count_nonzero(use) < (1 - PAUSES) * np.count_nonzero(steps):
        raise InputError(
            f"{path}: its times do not keep step with its frame numbers: correct them, or give "
            "--option fps=... to count frames alone"
        )
    residual = float((off[use] / usual).max())
    cuts = ~even
    cuts[1:] |= np.diff(group[before]) != 0
    line, row = np.cumsum(cuts, dtype=np.int64)[even & rising], after[even & rising]
    x, y = (_centred(values[row].astype(np.float64), line) for values in (frames, time))
    slope = float((x * x).sum() / (x * y).sum()) if np.ptp(x) > 0 else count / lasted
    whole, coarse = _whole(slope), digit * slope > 1
    fits = abs(count / whole - lasted) <= digit * (int(group.max()) + 1)
    if fits and (not coarse or np.abs(x / whole - y).max() <= 1 / whole):
        return whole, residual
    return _rounded(slope if coarse else count / lasted), residual


def _centred(values: Floats, line: Ints) -> Floats:
    """Return values without the mean of each line."""
    size = np.maximum(np.bincount(line), 1)
    return np.asarray(values - (np.bincount(line, values) / size)[line])


def _whole(rate: float) -> float:
    """Return the nearest rate [Hz] that is whole, or below 1 Hz of a whole period."""
    return float(round(rate)) if rate >= 1 else 1.0 / round(1.0 / rate)


def _rounded(rate: float) -> float:
    """Return a rate [Hz], below 1 Hz its period, rounded to a millionth."""
    return round(rate, 6) if rate >= 1 else 1.0 / round(1.0 / rate, 6)


def _check_unit(path: Path, column: str | None, rate: float, numbered: bool) -> None:
    """Refuse times of no stated unit that make a rate which no camera has if they are seconds."""
    if column is None or SLOWEST < rate <= FASTEST:
        return
    fitting = [
        f"time_unit={unit} ({rate / length:.4g} frames/s)"
        for unit, length in IN_SECONDS.items()
        if unit == "s" or SLOWEST < rate / length <= FASTEST
    ]
    frames = (
        "or --option fps=... to count its frame numbers alone"
        if numbered
        else f"or, if they are frame numbers, --option {shlex.quote(f'frame={column}')} --fps ..."
    )
    raise InputError(
        f"{path}: no unit is stated of the times of column {column!r}, which would make "
        f"{rate:.4g} frames/s if they were seconds: say what they are by --option "
        f"{' or --option '.join(fitting)}, {frames}"
    )


def refuse_uneven_frames(
    path: Path, frames: Floats | Ints, place: Place, first: float | None = None
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


def rounding(time: Floats, unit: float = 1.0) -> float:
    """Return the step to which times [s] are rounded, at least a microsecond [s].

    That is a power of ten of the ``unit`` [s] in which they were written.
    """
    written = time / unit
    exact = max(1e-7, 2 * float(np.spacing(np.abs(written).max())))
    kept = (digits for digits in range(6) if np.abs(written - written.round(digits)).max() < exact)
    return max(1e-6, unit * 10.0 ** -next(kept, 6))


def irregular_rate(path: Path, time: Floats, track: Ints, unit: float = 1.0) -> float | None:
    """Return the usual rate [Hz] of a clock that ticks unevenly, or None where it ticks evenly."""
    before, after = _neighbours(track, time)
    step = time[after] - time[before]
    if len(step) == 0 or not (step > 0).all():
        return None
    usual = float(np.median(step))
    off = np.count_nonzero(np.abs(step / usual - np.rint(step / usual)) > UNEVEN)
    if off < max(MIN_IRREGULAR_STEPS, IRREGULAR_SHARE * len(step)):
        return None
    if usual < MIN_ROUNDINGS_PER_STEP * (digit := rounding(time, unit)):
        raise InputError(
            f"{path}: its times are rounded to {digit:g} s, too coarsely for frames about "
            f"{usual:.3g} s apart: write them with more digits, or add a column of frame numbers"
        )
    return float(f"{1.0 / usual:.3g}") if usual <= 1 else 1.0 / float(f"{usual:.3g}")


def even_rows(time: Floats, track: Ints, rate: float) -> tuple[Ints, Ints, Floats, Floats]:
    """Return rows around each tick of an even clock, the share of the way between, and times [s].

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


def _neighbours(group: Ints, *keys: Floats | Ints) -> tuple[Ints, Ints]:
    """Return rows and the next row of the same group, in the order of the keys."""
    order: Ints = np.lexsort((*keys, group))
    same = np.diff(group[order]) == 0
    return order[:-1][same], order[1:][same]


def refuse_times_going_back(path: Path, time: Floats, track: Ints, place: Place) -> None:
    """Refuse times [s] that are earlier than those of the same ``track`` on a line above.

    Clock times do so at midnight, and when daylight saving time ends. Sorted, they would be frames
    that lie hours apart.
    """
    before, after = _neighbours(track)
    back = after[time[after] < time[before]]
    refuse_rows(
        np.sort(back).tolist(),
        lambda row: (
            f"{path}: the time of {place(row)} is earlier than the one before of the same "
            "individual (past midnight, or daylight saving?): write times that rise, or sort the "
            "rows by time"
        ),
    )


def seconds(path: Path, column: str, values: Floats | TextColumn, unit: str | None) -> Floats:
    """Return times in seconds: numbers of a unit, ISO 8601 dates, or clock times: 0:01:02.5."""
    if not isinstance(values, TextColumn):
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
