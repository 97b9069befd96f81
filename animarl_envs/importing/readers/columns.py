"""What people and programs call a table's columns, and which part each plays."""

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require
from animarl_envs.importing.clock import LARGEST_FRAME
from animarl_envs.importing.table_layout import UNIT_NAMES, bare_unit
from animarl_envs.importing.tables import Table, open_table

Whole = NDArray[np.int64]


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
        """The same, where the columns of frames or times are named."""
        if time is not None:
            return replace(
                self,
                frame=None,
                time=time,
                time_unit=time_unit or (self.time_unit if time == self.time else ""),
            )
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


# -- rows ------------------------------------------------------------------------------------------


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
    table: Table, recording: str, cell: Whole, individuals: list[str], rows: Whole, first: int = 0
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
            f"{table.path}: {recording}, frame {first + frame}, {individuals[who]} has two rows: "
            "drop the duplicate, or name the recording column"
        )
