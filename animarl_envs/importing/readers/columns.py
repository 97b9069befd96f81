"""What people and programs call a table's columns, and the frames and rates that times imply."""

import math
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require
from animarl_envs.importing.table_layout import UNIT_NAMES, bare_unit
from animarl_envs.importing.tables import Table, Words, open_table

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

# Names without blanks, underscores, points and capitals; those of an earlier rank are preferred,
# two of one rank are unclear.
USUAL_NAMES = {
    "frame": (
        "frame frames framenumber frameno frameid frameidx frameindex framenum nframe fnum "
        "imagenumber imageid bild",
        "image img slice",
    ),
    "time": (
        "time times t seconds sec secs trialtime zeit positiont",
        "timestamp timestamps datetime recordingtime elapsed elapsedtime clock date",
    ),
    "individual": (
        "trackid individual individuals individualid individualname animal animalid animalname "
        "subject subjectid subjectname track tier",
        "id object objectid obj ind agent agentid identity ids tagid particle particleid mouse "
        "mouseid fly flyid fish fishid rat ant antid bird birdid "
        "larva larvaid worm wormid",
        "name tag label",
    ),
    "recording": (
        "recording recordingid recordingname trial trialid trialname",
        "session sessionid video videoid videoname movie clip run runid experiment episode "
        "episodeid replicate file filename aufnahme",
    ),
    "confidence": ("confidence likelihood score probability prob",),
}
CLOCKS = ("frame", "time")
_WORDS = r"pos|position|coord|coordinate|centroid|center|centre|loc|location|wcentroid"
_AXIS = re.compile(rf"(?:(?:{_WORDS}|c)?[xy]|[xy](?:{_WORDS}|c)?)")
_ANGLE_UNIT = re.compile(r"[\s_/\[(]+(rad|deg)(?:ians?|rees?|s)?[\])]?\s*$", re.IGNORECASE)
RADIANS = {"rad": 1.0, "deg": math.pi / 180.0}
EXACT = ("x", "y")
MOTION = ("vel", "speed", "acc")  # how names of pairs begin that are no positions


@dataclass(frozen=True)
class Named:
    """A column's name without its unit, and the unit (``""`` where none is stated)."""

    column: str
    bare: str
    unit: str

    @property
    def key(self) -> str:
        """Name without separators and case, for matching."""
        return re.sub(r"[\s_.\-#]+", "", self.bare).lower()

    @property
    def clock(self) -> str:
        """The key without what stands in brackets: of times, how they are written."""
        return re.split(r"[\[(]", self.key)[0]


@dataclass(frozen=True)
class Columns:
    """Which columns play which part; ``None`` where there is none or it is not clear."""

    frame: str | None = None
    time: str | None = None
    individual: str | None = None
    recording: str | None = None
    confidence: str | None = None
    x: str | None = None
    y: str | None = None
    unit: str = ""
    time_unit: str = ""
    unclear: tuple[str, ...] = ()

    @property
    def is_long(self) -> bool:
        """Whether a row is of one frame or time, and of one individual or recording."""
        clocked = self.frame is not None or self.time is not None
        several = self.individual is not None or self.recording is not None
        return clocked and several and self.x is not None and not self.unclear

    def with_clock(self, frame: str | None, time: str | None, time_unit: str | None) -> Self:
        """The same, where the columns of frames or times are named; times are in s by default."""
        if time is not None:
            return replace(self, frame=None, time=time, time_unit=time_unit or "s")
        if frame is not None:
            return replace(self, frame=frame, time=None)
        return replace(self, time_unit=time_unit or self.time_unit)


def parsed_names(names: Sequence[str], units: Sequence[str] = ()) -> list[Named]:
    """Return names and units apart; a unit stands in brackets, behind a slash, last, or below."""
    found, pairs = [], pairs_of(names)
    letters = [who for who in pairs if len(who) == 1 and who.lower() not in UNIT_NAMES]
    for at, name in enumerate(names):
        below = units[at] if at < len(units) else ""
        match = re.fullmatch(r"(.*?)[\s_]*[\[(]\s*([^\])]*?)\s*[\])]\s*", name) or re.fullmatch(
            r"(.+?)(?:_|\s*/\s*|\s+)([A-Za-zµ]+)", name
        )
        unit = bare_unit(match[2]) if match and match[2].lower() in UNIT_NAMES else ""
        letter = match[2] if match and len(match[2]) == 1 else ""
        if name in pairs.get(letter, ()) and any(
            pairs[one][0][:2] == pairs[letter][0][:2] for one in letters
        ):
            unit = ""  # but an animal: x_m and y_m beside x_f and y_f
        bare = match[1] if match and unit else name
        found.append(Named(name, bare.strip(), unit or below))
    return found


def pairs_of(names: Sequence[str]) -> dict[str, list[str]]:
    """Return pairs of columns that differ in an x and a y, by what else is in their names."""
    found: dict[str, list[str]] = {}
    known = set(names)
    for name in names:
        for pattern in (r"^([xX])[_ .]?(.+)$", r"^(.+)[_ .]([xX])$"):
            match = re.match(pattern, name)
            if match is None:
                continue
            first = pattern.startswith("^([xX])")
            axis, who = (match[1], match[2]) if first else (match[2], match[1])
            other = "y" if axis == "x" else "Y"
            partner = other + name[1:] if first else name[:-1] + other
            if partner in known and partner != name:
                found[who] = [name, partner]
                break
    return found


def refuse_unused_pair(table: Table, found: Columns) -> None:
    """Refuse a table of one animal with another pair of columns that may be of a second one."""
    column = {one.bare: one.column for one in parsed_names(table.names)}
    for who, (x, y) in pairs_of(list(column)).items():
        if column[x] != found.x and not who.lower().startswith(MOTION):
            raise InputError(
                f"{table.path}: columns {column[x]!r} and {column[y]!r} are left over beside "
                f"{found.x!r} and {found.y!r}: name the pair of each individual by --source "
                f"wide-table --option 'columns={{a: [{found.x}, {found.y}], "
                f"b: [{column[x]}, {column[y]}]}}', or of the only one"
            )


def find_columns(table: Table) -> Columns:
    """Return the part that each column plays, from its name."""
    known = parsed_names(table.names, table.units)
    parts: dict[str, str] = {}
    unclear = []
    for part, ranks in USUAL_NAMES.items():
        fitting = [[one for one in known if one.key in rank.split()] for rank in ranks]
        if part in CLOCKS:
            fitting += [[one for one in known if one.clock in rank.split()] for rank in ranks]
        best = next(filter(None, fitting), [])
        if len(best) == 1:
            parts[part] = best[0].column
            if part == "time":
                parts["time_unit"] = best[0].unit or best[0].key[len(best[0].clock) :].strip("[]()")
        elif best:
            unclear.append(part)
    by_key = {one.key: one for one in known}
    pairs = [
        (one, by_key[partner])
        for one in known
        if "x" in one.key and _AXIS.fullmatch(one.key)  # with no animal's name
        if (partner := one.key.replace("x", "y")) in by_key
    ]
    if len(pairs) > 1:
        pairs = [pair for pair in pairs if (pair[0].key, pair[1].key) == EXACT] or pairs
    if len(pairs) > 1:
        unclear.append("x")
    if len(pairs) == 1:
        ((x, y),) = pairs
        if x.unit != y.unit:
            raise InputError(
                f"columns {x.column!r} and {y.column!r} have units {x.unit or 'none'} and "
                f"{y.unit or 'none'}: give both the same"
            )
        parts |= {"x": x.column, "y": y.column, "unit": x.unit}
    return Columns(**parts, unclear=tuple(unclear))  # type: ignore[arg-type]


def radians_per_unit(path: Path, column: str, unit: str | None) -> float:
    """Of a table's column of headings, whose unit is stated or stands in its name.

    Raises InputError if neither says whether these are radians or degrees.
    """
    match = _ANGLE_UNIT.search(column)
    named = unit or (match[1].lower() if match else None)
    if named not in RADIANS:
        raise InputError(
            f"{path}: column {column!r} has angles in {named or 'no stated unit'}: give --option "
            "angle_unit=rad or angle_unit=deg"
        )
    return RADIANS[named]


def suggested_command(path: Path) -> str | None:
    """Return a table's columns and the command to type; ``None`` for no table."""
    try:
        table = open_table(path)
        found = find_columns(table)
    except InputError as error:
        return str(error).removeprefix(f"{path}: ")
    if len(table.names) < 2:
        return None
    used = {name for name in vars(found).values() if isinstance(name, str)}
    rest = [name for name in table.names if name and name not in used]
    parts = {}
    for part in ("frame", "individual", "x", "y"):
        clock = found.frame or found.time
        known = clock if part == "frame" else getattr(found, part)
        if known is None and rest:
            known = rest.pop(0)
        option = "time" if part == "frame" and found.frame is None and found.time else part
        parts[option] = known or "COLUMN"
    options = " ".join(f"--option {shlex.quote(f'{part}={name}')}" for part, name in parts.items())
    fps = "" if found.time else " --fps RATE"
    shown = ", ".join(name or "(no name)" for name in table.names[:30])
    return (
        f"its columns are {shown} ({table.description}), and which is which is not clear: put the "
        f"right names into: animarl import {shlex.quote(str(path))} --source long-table {options}"
        f"{fps} --target auto --out demos.npz"
    )


# -- times -----------------------------------------------------------------------------------------


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


def frame_numbers(table: Table, column: str, frames: NDArray[np.float64]) -> Whole:
    """Return frames as whole numbers, or refuse what is none."""
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < LARGEST_FRAME))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{table.path}: {table.place(at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int64)


def refuse_two_rows(
    table: Table, recording: str, cell: Whole, individuals: list[str], rows: Whole
) -> None:
    """Refuse a second row of one frame and individual; ``rows`` are those of the table."""
    twice = np.flatnonzero(np.bincount(cell) > 1)
    if len(twice):
        frame, who = divmod(int(twice[0]), len(individuals))
        second = int(np.flatnonzero(cell == twice[0])[1])
        before = cell[:second][cell[:second] % len(individuals) == who]
        require(
            before.max() == twice[0],
            f"{table.path}: frames begin again at {table.place(int(rows[second]))}, as of a second "
            "session: add a column recording that tells the sessions apart, or split the file",
        )
        raise InputError(
            f"{table.path}: {recording}, frame {frame}, {individuals[who]} has two rows: drop the "
            "duplicate, or name the recording column"
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
