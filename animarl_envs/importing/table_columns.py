"""Which column of a table plays which part, from the names in its header.

Every column is a clock, a name (of an individual, keypoint or recording), a position or its
confidence; all others are reported as not used. Columns of positions that could be of an animal and
fit no part are refused, so that none is lost or invented.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Self

from animarl_envs.errors import InputError
from animarl_envs.importing.table_layout import UNIT_NAMES, Layout, bare_unit
from animarl_envs.importing.tracks import CENTROID

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
        "subject subjectid subjectname track tier individuallocalidentifier",
        "id object objectid obj ind agent agentid identity ids tagid particle particleid mouse "
        "mouseid fly flyid fish fishid rat ant antid bird birdid "
        "larva larvaid worm wormid bat batid bee beeid moth mothid termite termiteid locust "
        "locustid taglocalidentifier",
        "name tag label",
    ),
    "recording": (
        "recording recordingid recordingname trial trialid trialname",
        "session sessionid video videoid videoname movie clip run runid experiment episode "
        "episodeid replicate file filename aufnahme",
    ),
    "arena": (
        "arena arenaid arenanumber dish dishid well wellid cage cageid tank tankid vial vialid "
        "chamber chamberid petridish enclosure",
    ),
    "keypoint": (
        "node nodename keypoint keypointname keypointid bodypart bodyparts bodypartname joint",
    ),
    "confidence": ("confidence likelihood score probability prob",),
}
CLOCKS = ("frame", "time")
SECONDS = ("seconds", "secs", "sec")  # names of columns of times that state their unit
DEGREES = "deg"  # the unit of longitudes and latitudes
LENGTHS = {"px", "mm", "cm", "m", "um", "inch"}
_WORDS = r"pos|position|coord|coordinate|centroid|center|centre|loc|location|wcentroid"
_AXIS = re.compile(rf"(?:(?:{_WORDS}|c)?[xy]|[xy](?:{_WORDS}|c)?)")
_LETTER = re.compile(r"c\W[xy]|c_[xy]", re.IGNORECASE)  # beside others, an animal c
_ANGLE_UNIT = re.compile(r"[\s_/\[(]+(rad|deg)(?:ians?|rees?|s)?[\])]?\s*$", re.IGNORECASE)
RADIANS = {"rad": 1.0, "deg": math.pi / 180.0}
EXACT = ("x", "y")
BOXES = (
    ("xmin", "ymin", "xmax", "ymax"),
    ("minx", "miny", "maxx", "maxy"),
    ("xtl", "ytl", "xbr", "ybr"),
    ("left", "top", "right", "bottom"),
)
"""Left, upper, right and lower edge of a box around an animal."""
CORNERS = ("x1", "y1", "x2", "y2")  # of a box, or positions of two animals
_NAMES = {
    "parts": "nose snout head neck ear ears tail tailbase tailtip tailend tailroot spine body "
    "bodycenter bodycentre center centre centroid midbody thorax abdomen wing leg paw foot hand "
    "arm elbow knee ankle wrist shoulder hip back beak bill eye antenna mouth jaw chin fin torso "
    "trunk chest belly rump haunch hindpaw forepaw forelimb hindlimb limb toe crown nape proboscis "
    "whisker haltere stinger claw com node joint keypoint bodypart",
    "body": "body center centre centroid com",
    "single": "head nose snout thorax",
    "sides": "left right l r front hind fore rear upper lower base tip mid middle top bottom end "
    "inner outer of the",
    "landmarks": "corner corners cage arena wall food feeder port spout lever led shelter",
    "no position": "vel velocity velo speed acc acceleration accel std sd sem se var variance cov "
    "err error sigma spread quat quaternion rot rotation orientation orient dir direction heading "
    "angle force gyro mag torque size width height scale shift offset delta diff displacement "
    "gradient dist distance",
    "mates": "mate partner other conspecific opponent neighbour neighbor intruder stimulus",
}
PARTS, BODY, SINGLE, SIDES, LANDMARKS, NO_POSITION, MATES = (
    set(words.split()) for words in _NAMES.values()
)
"""Words in names of pairs of columns. Of parts in ``BODY`` and ``SINGLE`` an individual has one:
``head2`` is of another. ``MATES`` are individuals beside the one of x and y."""
CORNER_NAMES = {f"{a}{b}" for a in ("top", "bottom") for b in ("left", "right")}
LONGITUDES = {"longitude", "lon", "long", "lng", "locationlong", "locationlon", "gpslongitude"}
LATITUDES = {"latitude", "lat", "locationlat", "gpslatitude"}


@dataclass(frozen=True)
class Named:
    """A column's name without its unit, and the unit (``""`` where none is stated)."""

    column: str
    bare: str
    unit: str

    @property
    def key(self) -> str:
        """Name without separators and case, for matching."""
        return _key(self.bare)

    @property
    def clock(self) -> str:
        """The key without what stands in brackets: of times, how they are written."""
        return re.split(r"[\[(]", self.key)[0]


@dataclass(frozen=True)
class Position:
    """Columns with the position of one keypoint of one individual.

    ``columns`` are x and y, or the left, upper, right and lower edge of a box, whose centre is the
    position. ``individual`` is ``""`` where rows, or nothing, name it.
    """

    columns: tuple[str, ...]
    individual: str = ""
    keypoint: str = CENTROID
    score: str | None = None


@dataclass(frozen=True)
class Columns:
    """Which columns play which part; ``None`` where there is none or it is not clear.

    ``tracks`` are columns with the name of the individual that the positions of an ``individual``
    of the header are of, row by row. ``refusal`` is why the positions are not clear. ``landmarks``
    are pairs of columns that are of no animal by their names.
    """

    frame: str | None = None
    time: str | None = None
    individual: str | None = None
    keypoint: str | None = None
    recording: str | None = None
    arena: str | None = None
    confidence: str | None = None
    positions: tuple[Position, ...] = ()
    tracks: Mapping[str, str] = field(default_factory=dict)
    unit: str = ""
    time_unit: str = ""
    unclear: tuple[str, ...] = ()
    refusal: str = ""
    landmarks: tuple[str, ...] = ()

    @property
    def is_long(self) -> bool:
        """Whether a row is of one frame or time, and of one individual, keypoint or recording."""
        clocked = self.frame is not None or self.time is not None
        several = self.individual or self.keypoint or self.recording or self.arena
        one = len({position.individual for position in self.positions}) == 1
        return clocked and several is not None and one and not (self.unclear or self.refusal)

    @property
    def is_wide(self) -> bool:
        """Whether a row is of one frame, and holds all individuals."""
        named = self.individual is not None or "individual" in self.unclear
        return not named and bool(self.positions or self.refusal)

    def with_clock(self, frame: str | None, time: str | None, time_unit: str | None) -> Self:
        """Return the same with the named column of frames or times."""
        if time is not None:
            known = self.time_unit if time == self.time else ""
            return replace(self, frame=None, time=time, time_unit=time_unit or known)
        if frame is not None:
            return replace(self, frame=frame, time=None)
        return replace(self, time_unit=time_unit or self.time_unit)


def find_columns(table: Layout) -> Columns:
    """Return the part that each column plays, from its name."""
    boxes = _find_boxes(table.names)
    edges = set(chain(*boxes.values()))
    known = [one for one in parsed_names(table.names) if one.column not in edges]
    parts, unclear = _parts_by_name(known)
    columns = Columns(**parts, unclear=tuple(unclear))  # type: ignore[arg-type]
    plain = [(x.column, y.column) for x, y in _plain_pairs(known)]
    if len(plain) > 1:
        (x, y), *_ = plain
        choice = f"--source long-table --option x={x} --option y={y}"
        if columns.individual is None:
            choice = f"--source wide-table --option {columns_option({'animal': (x, y)})}"
        listed = ", ".join(chain(*plain))
        return replace(
            columns, refusal=f"columns {listed} are each a position: choose a pair by {choice}"
        )
    corners = corners_of(table.names)
    if corners and columns.individual and not plain:
        return replace(columns, positions=(Position(corners),))
    columns = _with_named_pairs(replace(columns, positions=tuple(map(Position, plain))), known)
    if boxes and not (columns.positions or columns.refusal):
        positions = tuple(Position(columns, name) for name, columns in boxes.items())
        return replace(columns, positions=positions)
    return columns


def unit_of(table: Layout, positions: Sequence[Position]) -> str:
    """Return the unit of columns of positions, ``""`` where none is stated.

    Raises InputError if they have several.
    """
    named = {one.column: one for one in parsed_names(table.names, table.units)}
    columns = [named[name] for name in chain(*(one.columns for one in positions)) if name in named]
    units = {
        one.column: DEGREES
        if one.key in LONGITUDES | LATITUDES
        else one.unit
        if one.unit in LENGTHS
        else ""
        for one in columns
    }
    if len(set(units.values())) > 1:
        x = columns[0].column
        y = next(name for name, unit in units.items() if unit != units[x])
        raise InputError(
            f"columns {x!r} and {y!r} have units {units[x] or 'none'} and {units[y] or 'none'}: "
            "give all the same"
        )
    return next(iter(units.values()), "")


def _parts_by_name(known: Sequence[Named]) -> tuple[dict[str, str], list[str]]:
    """Return the columns of each part but positions, and the parts that several may play."""
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
                unit = best[0].unit or best[0].key[len(best[0].clock) :].strip("[]()")
                parts["time_unit"] = unit or "s" * (best[0].clock in SECONDS)
        elif best:
            unclear.append(part)
    return parts, unclear


def _plain_pairs(known: Sequence[Named]) -> list[tuple[Named, Named]]:
    """Return pairs with no name of an animal: the one of x and y, else all, else of degrees."""
    named = len(pairs_of(one.bare for one in known)) > 1
    by_key = {one.key: one for one in known if not (named and _LETTER.fullmatch(one.bare))}
    pairs = [
        (one, by_key[partner])
        for key, one in by_key.items()
        if "x" in key and _AXIS.fullmatch(key)
        if (partner := key.replace("x", "y")) in by_key
    ]
    if pairs:
        return [pair for pair in pairs if (pair[0].key, pair[1].key) == EXACT] or pairs
    east, north = ([one for one in known if one.key in keys] for keys in (LONGITUDES, LATITUDES))
    return list(zip(east, north, strict=True)) if len(east) == len(north) == 1 else []


def _with_named_pairs(so_far: Columns, known: Sequence[Named]) -> Columns:
    """Return the same with pairs of columns that are named by individual, keypoint or both."""
    used = set(chain(*(position.columns for position in so_far.positions)))
    bare = {one.bare: one for one in known}
    if len(bare) < len(known):
        bare = {one.column: one for one in known}
    pairs = {
        name: (bare[x].column, bare[y].column)
        for name, (x, y) in pairs_of(bare).items()
        if bare[x].column not in used and not _is_no_position(name, x, bare)
    }
    landmarks = tuple(name for name in pairs if _is_landmark(name))
    pairs = {name: pair for name, pair in pairs.items() if name not in landmarks}
    so_far = replace(so_far, landmarks=landmarks)
    bodies = split_names(list(pairs))
    named = bodies is None or any(individual for individual, _ in bodies)
    if not pairs or (so_far.positions and so_far.individual and named):
        return so_far  # rows of individuals have their own position
    if refusal := _why_unclear(so_far, pairs, bodies):
        return replace(so_far, refusal=refusal)
    columns = {one.key: one.column for one in known}
    positions = tuple(
        Position(pair, individual, part, None if part == CENTROID else _score_of(name, columns))
        for (name, pair), (individual, part) in zip(pairs.items(), bodies or (), strict=True)
    )
    parts: dict[str, list[str]] = {}
    for position in positions:
        parts.setdefault(position.individual, []).append(position.keypoint)
    tracks = {
        name: columns[key] for name in parts if name and (key := _key(name) + "track") in columns
    }
    alike = len(tracks) == len(parts) and len(set(map(tuple, parts.values()))) == 1
    return replace(
        so_far, positions=(*so_far.positions, *positions), tracks=tracks if alike else {}
    )


def _why_unclear(
    columns: Columns, pairs: Mapping[str, tuple[str, str]], bodies: Sequence[tuple[str, str]] | None
) -> str:
    """Return why it is not clear what pairs of columns are of, and how to say it; else nothing."""
    all_columns = ", ".join(chain(*pairs.values()))
    if bodies is None:
        return (
            f"columns {all_columns} may be of several individuals or of parts of one: say "
            f"--source wide-table --option {columns_option(pairs)} if each pair is an individual "
            f"or --option {columns_option({'animal': pairs})} if they are parts of one"
        )
    if not any(individual for individual, _ in bodies):
        return ""
    name, (x, y) = next(iter(pairs.items()))
    if columns.individual:
        return (
            f"columns {all_columns} name individuals, and so does the column "
            f"{columns.individual!r}: choose a pair by --source long-table --option x={x} --option "
            f"y={y}"
        )
    if columns.positions and (len(pairs) > 1 or name.lower() not in MATES):
        whole = columns.positions[0].columns
        return (
            f"columns {x!r} and {y!r} are left over beside {whole[0]!r} and {whole[1]!r}: name the "
            "pair of each individual by --source wide-table --option "
            f"{columns_option({'a': whole, 'b': (x, y)})} or leave one of them out"
        )
    return ""


def _score_of(name: str, columns: Mapping[str, str]) -> str | None:
    """Return the column of the confidence of what a pair of columns is of, by keys of names."""
    key = _key(name)
    words = USUAL_NAMES["confidence"][0].split()
    return next(
        (columns[k] for word in words for k in (key + word, word + key) if k in columns), None
    )


def parsed_names(names: Sequence[str], units: Sequence[str] = ()) -> list[Named]:
    """Return names and units apart; a unit stands in brackets, behind a slash, last, or below."""
    parsed, pairs = [], pairs_of(names)
    letters = [name for name in pairs if len(name) == 1 and name.lower() not in UNIT_NAMES]
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
        parsed.append(Named(name, bare.strip(), unit or below))
    return parsed


def pairs_of(names: Iterable[str]) -> dict[str, list[str]]:
    """Return pairs of columns that differ in an x and a y, by what else is in their names."""
    pairs: dict[str, list[str]] = {}
    known = dict.fromkeys(names)
    for name in known:
        for pattern in (r"^([xX])[_ .:\-]?(.+)$", r"^(.+)[_ .:\-]([xX])$"):
            match = re.match(pattern, name)
            if match is None:
                continue
            first = pattern.startswith("^([xX])")
            axis, rest = (match[1], match[2]) if first else (match[2], match[1])
            other = "y" if axis == "x" else "Y"
            partner = other + name[1:] if first else name[:-1] + other
            if partner in known and partner != name:
                pairs[rest] = [name, partner]
                break
    return pairs


def split_names(names: Sequence[str]) -> list[tuple[str, str]] | None:
    """Return individual (``""``: the only one) and body part of each name; ``None`` if unclear."""
    if all(map(is_body_part, names)):
        return [("", name) for name in names]
    cut = [_at_part(name) for name in names]
    if any(cut) or any(map(is_body_part, names)):
        return [pair for pair in cut if pair] if all(cut) else None
    halves = [re.fullmatch(r"(.+?)[\s_.:\-]+(.+)", name) for name in names]
    if all(halves):
        first, second = ({half[k] for half in halves if half} for k in (1, 2))
        if min(len(first), len(second)) > 1 and len(first) * len(second) == len(names):
            return None  # each of several with each of several
    return [(name, CENTROID) for name in names]


def is_body_part(name: str) -> bool:
    """Return whether a name is of a part of a body: ``left_ear``, ``tail2``, but not ``body2``."""
    words = _words(name)
    numbered = bool(words) and words[-1].isdecimal()
    letters = [word for word in words if not word.isdecimal()]
    parts = [word for word in letters if word in PARTS]
    return (
        bool(parts)
        and all(word in PARTS | SIDES for word in letters)
        and not (numbered and parts[-1] in BODY | SINGLE and letters[-1] == parts[-1])
    )


def _at_part(name: str) -> tuple[str, str] | None:
    """Return a name cut in individual and body part, in either order."""
    numbered = re.fullmatch(r"(\D+?)[\s_.:\-]*(\d+)", name)
    if numbered and is_body_part(numbered[1]) and _words(numbered[1])[-1] in SINGLE:
        return numbered[2], numbered[1]
    cuts = [match.span() for match in re.finditer(r"[\s_.:\-]+|(?<=[a-z\d])(?=[A-Z])", name)]
    for start, stop in cuts:
        if is_body_part(name[stop:]) and name[:start]:
            return name[:start], name[stop:]
    for start, stop in reversed(cuts):
        if is_body_part(name[:start]) and name[stop:]:
            return name[stop:], name[:start]
    return None


def _is_landmark(name: str) -> bool:
    """Return whether a pair of columns is of a place by its name, such as ``corner1``."""
    words = [word for word in _words(name) if not word.isdecimal()]
    named = any(word in LANDMARKS for word in words) and set(words) <= LANDMARKS | SIDES
    return named or "".join(words) in CORNER_NAMES


def _is_no_position(name: str, x: str, known: Iterable[str]) -> bool:
    """Return whether a pair is of velocities, spreads or the like, or of a quaternion."""
    other = "w" + x[1:] if x[:1] in "xX" and name in x[1:] else x[:-1] + "w"
    return other in known or bool(NO_POSITION & set(_words(name)))


def _words(name: str) -> list[str]:
    """Return the words and numbers of a name, in small letters."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+", name)]


def _find_boxes(names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return columns of the edges of boxes around each individual (``""``: that of the row)."""
    by_key = {_key(re.split(r"\s*[\[(]", name)[0]): name for name in names}
    boxes = {}
    for family in (*BOXES, CORNERS):
        for key in by_key:
            before = key.removesuffix(family[0])
            edges = [by_key.get(before + edge) for edge in family]
            name = re.sub(r"(bbox|bb|box)$", "", before)
            certain = family != CORNERS or name != before
            if key.endswith(family[0]) and certain and all(edges):
                boxes[name] = tuple(edge for edge in edges if edge)
        if boxes:
            return boxes
    return {}


def corners_of(names: Iterable[str]) -> tuple[str, ...] | None:
    """Return columns x1, y1, x2, y2, where these are all pairs: of a box, or of two animals."""
    by_key = {one.key: one.column for one in parsed_names(list(names))}
    fits = all(key in by_key for key in CORNERS) and not {"x3", "y3"} & set(by_key)
    return tuple(by_key[key] for key in CORNERS) if fits else None


def is_idtracker(table: Layout) -> bool:
    """Return whether columns are as idTracker 1 writes them: X1, Y1, ProbId1, ..."""
    return {"X1", "Y1", "ProbId1"} <= set(table.names)


def radians_per_unit(path: Path, column: str, unit: str | None) -> float:
    """Return how many radians the unit of a column of headings is, stated or in its name.

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


def columns_option(columns: Mapping[str, object]) -> str:
    """Return the option, quoted for a shell, that says which columns are of which individual."""
    return "'columns=" + _as_yaml(columns).replace("'", "'\\''") + "'"


def _as_yaml(value: object) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_as_yaml(k)}: {_as_yaml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_as_yaml, value)) + "]"
    word = str(value)
    plain = re.fullmatch(r"[A-Za-z_][\w.\-]*", word) and word.lower() not in _YAML_WORDS
    return word if plain else json.dumps(word, ensure_ascii=False)


_YAML_WORDS = {"yes", "no", "on", "off", "true", "false", "null"}


def _key(name: str) -> str:
    return re.sub(r"[\s_.\-#]+", "", name).lower()
