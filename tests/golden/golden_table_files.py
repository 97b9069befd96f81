# ruff: noqa: E501  (a case a line)
"""Small tables, workbooks and arrays, made the same each time, for the golden table of readers.

Each case has a name, a function that writes it into an empty folder and returns its path, and what
the reader is told. ``golden_tables`` writes what is read of them into ``tables.json``.
"""

import datetime
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
from scipy.io import savemat

from tools.fuzz.layouts import BODIES, KINDS, NAMES, POSE, write_mat

FRAMES = 20
ROUNDED = np.round(BODIES[:FRAMES], 4)
RATE = 25.0
Write = Callable[[Path], Path]


@dataclass(frozen=True)
class Case:
    """One file; ``whole``: it is imported to the end by a recipe with these entries."""

    name: str
    write: Write
    source: str | None = None
    options: dict[str, Any] = field(default_factory=dict)
    whole: bool = False


def saved(name: str, save: Callable[[Path], object]) -> Write:
    """A file of this name in whatever folder, and its path."""

    def write(folder: Path) -> Path:
        save(folder / name)
        return folder / name

    return write


def text(content: str | bytes, name: str = "t.csv", encoding: str = "utf-8") -> Write:
    raw = content if isinstance(content, bytes) else content.encode(encoding)
    return saved(name, lambda path: path.write_bytes(raw))


def number(value: float, decimal: str) -> str:
    return repr(float(value)).replace(".", decimal)


def long_rows(
    clock: Callable[[int], str] = str, names: tuple[str, str] = NAMES, decimal: str = "."
) -> list[list[str]]:
    return [
        [clock(t), who, *(number(v, decimal) for v in ROUNDED[t, i])]
        for t in range(FRAMES)
        for i, who in enumerate(names)
    ]


def wide_rows(clock: Callable[[int], str] = str, decimal: str = ".") -> list[list[str]]:
    return [[clock(t), *(number(v, decimal) for v in ROUNDED[t].ravel())] for t in range(FRAMES)]


def joined(header: list[str], rows: list[list[str]], separator: str = ",") -> str:
    def cell(word: str) -> str:
        return f'"{word}"' if separator in word and separator.strip() else word

    return "".join(separator.join(map(cell, row)) + "\n" for row in [header, *rows])


LONG, WIDE = ["frame", "id", "x", "y"], ["frame", "x_male", "y_male", "x_female", "y_female"]
SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "bar": "|", "blanks": "  "}
ENCODINGS = {
    "utf-8": "Käfer", "utf-8-sig": "Käfer", "utf-16": "Käfer", "utf-16-le": "Käfer",
    "utf-16-be": "Käfer", "utf-32": "Käfer", "latin-1": "Käfer", "cp1252": "Käfer",
    "mac_roman": "Käfer", "cp1251": "самец", "shift_jis": "オス", "gb18030": "雄性",
}  # fmt: skip


def of_text() -> Iterator[Case]:
    for encoding, name in ENCODINGS.items():
        content = joined(LONG, long_rows(names=(name, "b")))
        yield Case(f"encoding {encoding}", text(content, encoding=encoding))
        named = {"encoding": encoding}
        yield Case(
            f"encoding {encoding} named", text(content, encoding=encoding), "long-table", named
        )
    for word, separator in SEPARATORS.items():
        for decimal in ".,":
            for shape, header, rows in (
                ("long", LONG, long_rows(decimal=decimal)), ("wide", WIDE, wide_rows(decimal=decimal))
            ):  # fmt: skip
                content = joined(header, rows, separator)
                yield Case(f"{shape}, {word}, decimal {decimal}", text(content))
    yield Case("trailing separators", text(joined(LONG, long_rows(), ";").replace("\n", ";\n")))
    yield Case("windows line ends", text(joined(LONG, long_rows()).replace("\n", "\r\n")))
    yield Case("old mac line ends", text(joined(LONG, long_rows()).replace("\n", "\r")))
    yield Case("no last line end", text(joined(LONG, long_rows()).rstrip("\n")))
    yield Case("blank lines", text(joined(LONG, long_rows()).replace("\n", "\n\n")))
    yield Case("two header rows", text(joined(LONG, [["#", "", "px", "px"], *long_rows()])))
    yield Case("units below", text(joined(LONG, [["", "", "mm", "mm"], *long_rows()])))
    yield Case("remarks above", text("# a tracker\nfps: 25\n\n" + joined(LONG, long_rows())))
    yield Case("no header", text(joined(LONG, long_rows()).partition("\n")[2]))
    yield Case("damaged utf-8", text(joined(LONG, long_rows()).encode() + b"9,\xed\xa0\x80,1,2\n"))
    yield Case(
        "quoted numbers", text(joined(LONG, [[r[0], r[1], f'"{r[2]}"', r[3]] for r in long_rows()]))
    )


def clock(seconds: float, point: str = ".", hours: bool = True) -> str:
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    whole = f"{minutes // 60}:{minutes % 60:02d}" if hours else f"{minutes}"
    return f"{whole}:{rest // 1000:02d}{point}{rest % 1000:03d}"


def iso(t: float, start: str = "2024-05-01T10:00:00", ending: str = "") -> str:
    moment = datetime.datetime.fromisoformat(start) + datetime.timedelta(seconds=t)
    return moment.isoformat(sep=" ", timespec="milliseconds") + ending


TIMES: dict[str, tuple[str, Callable[[int], str]]] = {
    "seconds": ("time", lambda t: repr(t / RATE)),
    "seconds from 1000": ("time", lambda t: repr(1000 + t / RATE)),
    "seconds, three digits": ("time", lambda t: f"{t / 30:.3f}"),
    "milliseconds": ("t [ms]", lambda t: str(40 * t)),
    "milliseconds of no unit": ("time", lambda t: str(40 * t)),
    "minutes": ("time (min)", lambda t: repr(t / RATE / 60)),
    "microseconds": ("time_us", lambda t: str(40_000 * t)),
    "clock": ("time", lambda t: clock(t / RATE)),
    "clock, decimal comma": ("time", lambda t: clock(t / RATE, ",")),
    "clock, minutes": ("time", lambda t: clock(t / RATE, hours=False)),
    "clock, minutes, decimal comma": ("time", lambda t: clock(t / RATE, ",", hours=False)),
    "clock past midnight": ("time", lambda t: clock((86_399.8 + t / RATE) % 86_400)),
    "iso": ("timestamp", lambda t: iso(t / RATE)),
    "iso with zone": ("timestamp", lambda t: iso(t / RATE, ending="+02:00")),
    "iso back by an hour": (
        "timestamp", lambda t: iso(t / RATE - 3600 * (t >= 10), "2024-10-27T02:59:59.600"),
    ),
    "iso, decimal comma": ("timestamp", lambda t: iso(t / RATE).replace(".", ",")),
    "days first": ("timestamp", lambda t: f"01/05/2024 10:00:{t / RATE:06.3f}"),
    "back by a step": ("time", lambda t: repr((t - 2 * (t == 10)) / RATE)),
    "a step missing": ("time", lambda t: repr((t + 5 * (t >= 10)) / RATE)),
    "a time missing": ("time", lambda t: "" if t == 3 else repr(t / RATE)),
    "between frames": ("time", lambda t: repr((t + 0.4 * (t == 10)) / RATE)),
    "all the same": ("time", lambda t: "1.5"),
    "truth values": ("time", lambda t: str(t > 10)),
}  # fmt: skip


def of_times() -> Iterator[Case]:
    for word, (column, when) in TIMES.items():
        yield Case(f"long, {word}", text(joined([column, *LONG[1:]], long_rows(when), ";")))
        yield Case(f"wide, {word}", text(joined([column, *WIDE[1:]], wide_rows(when), ";")))
    both = [[row[0], repr(int(row[0]) / RATE), *row[1:]] for row in long_rows()]
    yield Case("frame and time", text(joined(["frame", "time", *LONG[1:]], both)))
    yield Case(
        "milliseconds named", text(joined(["time", *LONG[1:]], long_rows(TIMES["milliseconds"][1]))),
        "long-table", {"time_unit": "ms"},
    )  # fmt: skip


CELLS = {
    "thousands with commas": "1,000", "thousands with points": "1.000,5", "a comma for a point": "1,5",
    "thousands with blanks": "1 000", "thousands with apostrophes": "1'000",
    "thousands and decimals": "1,000.5", "true": "True", "false": "FALSE", "hexadecimal": "0x1F",
    "exponent": "1e2", "infinity": "inf", "not a number": "nan", "empty": "", "dash": "-",
    "NA": "NA", "a word": "oops", "underscore": "1_000", "percent": "5%", "plus": "+5",
    "fullwidth digits": "５", "long digits": "1." + "3" * 40, "huge": "1e300", "a date": "2024-05-01",
}  # fmt: skip


def of_cells() -> Iterator[Case]:
    for word, cell in CELLS.items():
        rows = long_rows()
        rows[11][2] = cell
        yield Case(f"a cell with {word}", text(joined(LONG, rows, ";")))
    for word, separator in SEPARATORS.items():
        if separator != ",":
            rows = [[*row[:2], f"{900 + 12 * i:,}", "5"] for i, row in enumerate(long_rows())]
            yield Case(f"thousands, {word}", text(joined(LONG, rows, separator)))
            yield Case(
                f"thousands, {word}, decimal named", text(joined(LONG, rows, separator)),
                "long-table", {"decimal": ","},
            )  # fmt: skip
            rows = [[*row[:2], row[2].replace(",", "."), "5"] for row in rows]
            yield Case(f"thousands with points, {word}", text(joined(LONG, rows, separator)))
            rows = [[*row[:2], f"{i},125", "5"] for i, row in enumerate(long_rows())]
            yield Case(f"three decimals, {word}", text(joined(LONG, rows, separator)))
            whole = [[*row[:2], "1,000", "2,500"] for row in long_rows()]
            yield Case(f"all in thousands, {word}", text(joined(LONG, whole, separator)))
    truths = [[*row[:2], str(i % 2 == 0), str(i % 3 == 0)] for i, row in enumerate(long_rows())]
    yield Case("truth values for positions", text(joined(LONG, truths)))
    ones = [[*row[:2], str(i % 2), "1"] for i, row in enumerate(long_rows())]
    yield Case("zeros and ones for positions", text(joined(LONG, ones)))
    rows = wide_rows()
    named = [*WIDE, "seen"]
    yield Case("truth values beside", text(joined(named, [[*row, "True"] for row in rows])))
    for separator in ";|":
        lines = [[row[0], "1,000", "2,000", "3,000", "4,000"] for row in wide_rows()]
        yield Case(f"wide, all in thousands {separator}", text(joined(WIDE, lines, separator)))


HEADERS = {
    "x_ name": "x_male,y_male,x_female,y_female", "name _x": "male_x,male_y,female_x,female_y",
    "name.x": "male.x,male.y,female.x,female.y", "xname": "xmale,ymale,xfemale,yfemale",
    "x1": "x1,y1,x2,y2", "X1 (cm)": "X1 (cm),Y1 (cm),X2 (cm),Y2 (cm)", "x blank": "x 1,y 1,x 2,y 2",
    "letters": "x_m,y_m,x_f,y_f", "left over": "x,y,x_f,y_f", "lone": "x_male,y_male,x_female,z",
    "nobody": "a,b,c,d", "velocity": "x,y,velocity_x,velocity_y", "mm and cm": "x (mm),y (cm),a,b",
    "twice": "x_a,y_a,x_a,y_a", "centroids": "x_centroid,y_centroid,x_center,y_center",
    "bare": "x,y,area,angle", "capital": "X,Y,AREA,ANGLE", "empty names": ",,x,y",
}  # fmt: skip


def of_headers() -> Iterator[Case]:
    for word, header in HEADERS.items():
        yield Case(f"header {word}", text(joined(["frame", *header.split(",")], wide_rows())))
    longs = (
        "Frame number,Animal ID,X center (mm),Y center (mm)", "frame,animal,track_id,x", "t,id,x,y",
        "video,frame,x,y", "frame,identity,pos_x,pos_y", "Bild,Tier,X,Y", "slice,particle,x,y",
        "frame,label,x_px,y_px", "image,image_id,x,y",
    )  # fmt: skip
    for header in longs:
        yield Case(f"header {header}", text(joined(header.split(","), long_rows())))
    heading = [[*row, "90"] for row in long_rows()]
    options = {"heading": "angle", "angle_unit": "deg"}
    table = text(joined([*LONG, "angle"], heading))
    yield Case("heading", table, "long-table", options)
    for word, told in {
        "of no unit": {"heading": "angle"}, "in turns": {"heading": "angle", "angle_unit": "turns"},
        "of no column": {"heading": "phi_rad"}, "not named": {"angle_unit": "deg"},
    }.items():  # fmt: skip
        yield Case(f"heading {word}", table, "long-table", told)
    yield Case("no individual", text("frame,who,x,y\n0,a,1,2\n"), "long-table")
    yield Case("an unknown option", table, "long-table", {"colour": 1})
    score = [[*row, "0.5"] for row in long_rows()]
    yield Case("confidence", text(joined([*LONG, "likelihood"], score)))
    two = [[name, *row] for name in ("a", "b") for row in long_rows()]
    yield Case("two recordings", text(joined(["trial", *LONG], two)))
    for style in ("{0}_{1}", "{1}_{0}", "{0}{1}", "{0}.{1}"):
        for lost in WIDE[1:]:
            names = ["z" if one == lost else style.format(*one.split("_")) for one in WIDE[1:]]
            content = joined(["frame", *names], wide_rows())
            yield Case(f"header {','.join(names)}", text(content), "wide-table")
    rows = [[str(t + 5), *row[1:]] for t, row in enumerate(wide_rows())]
    for word, kept in {
        "late": rows, "a gap": rows[:10] + rows[11:], "a row twice": rows[:10] + rows[9:],
        "swapped": [*rows[:5], rows[6], rows[5], *rows[7:]],
    }.items():  # fmt: skip
        yield Case(f"wide, frames {word}", text(joined(WIDE, kept)))
    numbers = [row[1:] for row in wide_rows()]
    bare = text(joined(numbers[0], numbers[1:]))
    yield Case("no header, wide", bare, "wide-table", {"columns": {"a": numbers[0][:2]}})
    yield Case("no header, Anipose", bare, "movement", {"software": "Anipose"})
    columns = {"a": ["x_male", "y_male"]}
    yield Case("columns named", text(joined(WIDE, wide_rows())), "wide-table", {"columns": columns})


BAD = {
    "duplicate": "frame,id,x,y\n0,a,1,2\n0,a,1,2\n", "no rows": "frame,id,x,y\n", "empty": "",
    "negative": "frame,id,x,y\n0,a,1,2\n\n-1,a,1,2\n", "fraction": "frame,id,x,y\n0.5,a,1,2\n",
    "far": "frame,id,x,y\n0,a,1,2\n1000000000,a,1,2\n", "one column": "x\n1\n2\n",
    "short line": "frame,id,x,y\n0,a,1,2\n1,a,1\n", "long line": "frame,id,x,y\n0,a,1,2\n1,a,1,2,3\n",
    "nameless": "frame,id,x,y\n0,a,1,2\n1,,1,2\n", "quote": 'frame,id,x,y\n0,"a,1,2\n1,a,1,2\n',
    "returns": "frame,id,x,y\n0,a,1,2\r1,a,1,2\n", "binary": "frame,id,x,y\n0,a,1,2\0\n",
    "formula": "frame,id,x,y\n0,=A1,1,2\n1,=A1,1,2\n", "path": "frame,id,x,y\n0,../a,1,2\n1,../a,1,2\n",
    "long name": "frame,id,x,y\n0," + "a" * 300 + ",1,2\n", "frames swapped": "frame,x_a,y_a\n1,1,2\n0,1,2\n",
    "frames missing": "frame,x_a,y_a\n0,1,2\n2,1,2\n",
    "huge": "recording,frame,x,y\nr,0,1,2\nr,1,1e300,2\n", "cut": "frame,id,x,y\n0,a,1,2\n1,a",
    "times between": "recording,frame,x_a,y_a\na,0,1,2\na,1,1,2\na,1,1,2\nb,0,1,2\nb,1,1,2\n",
}  # fmt: skip


CUT = "long wide dlc_csv ethovision mothvr idtracker_csv tsv"
HALVED = "npz npy mat packed_mat mat73 slp dlc_h5 long_parquet trex"


def of_damage() -> Iterator[Case]:
    for word, content in BAD.items():
        yield Case(f"bad table, {word}", text(content))
    for word, names in {"cut": CUT, "half of": HALVED}.items():
        for name in names.split():

            def part(folder: Path, make: Write = KINDS[name].write, word: str = word) -> Path:
                raw = (path := make(folder)).read_bytes()
                path.write_bytes(raw[:-9] if word == "cut" else raw[: len(raw) // 2])
                return path

            yield Case(f"{word} {name}", part, KINDS[name].source)


def workbook(rows: list[list[Any]], **more: list[list[Any]]) -> Write:
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    for title, others in more.items():
        sheet = book.create_sheet(title)
        for row in others:
            sheet.append(row)
    return saved("t.xlsx", book.save)


def changed_workbook(member: str, old: str, new: str) -> Write:
    """A workbook of which one part is other text."""

    def write(folder: Path) -> Path:
        path = workbook([LONG, *of_numbers()])(folder)
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        parts[member] = parts[member].decode().replace(old, new, 1).encode()
        with zipfile.ZipFile(path, "w") as archive:
            for name, raw in parts.items():
                archive.writestr(name, raw)
        return path

    return write


def of_numbers() -> list[list[Any]]:
    return [
        [t, who, *map(float, ROUNDED[t, i])] for t in range(FRAMES) for i, who in enumerate(NAMES)
    ]


ENTITY = '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]>'


def of_workbooks() -> Iterator[Case]:
    rows = of_numbers()
    table = [LONG, *rows]
    yield Case("workbook", workbook(table))
    yield Case("workbook, remarks above", workbook([["made by us"], [], *table]))
    yield Case("workbook, two sheets", workbook(table, second=table))
    yield Case(
        "workbook, sheet named", workbook(table, second=table), "long-table", {"sheet": "second"}
    )
    yield Case("workbook, no such sheet", workbook(table), "long-table", {"sheet": "third"})
    yield Case("workbook, empty sheet beside", workbook(table, second=[]))
    moments = [
        [datetime.datetime(2024, 5, 1) + datetime.timedelta(seconds=row[0] / RATE), *row[1:]]
        for row in rows
    ]
    yield Case("workbook, dates", workbook([["time", *LONG[1:]], *moments]))
    yield Case("workbook, text for numbers", workbook([LONG, *([*map(str, row)] for row in rows)]))
    truths = [[*row[:2], row[0] > 3, row[0] > 5] for row in rows]
    yield Case("workbook, truth values", workbook([LONG, *truths]))
    gaps = [[*row[:3], None if row[0] == 4 else row[3]] for row in rows]
    yield Case("workbook, gaps", workbook([LONG, *gaps]))
    sheet = "xl/worksheets/sheet1.xml"
    words = 't="inlineStr"><is><t>frame</t></is>'
    for index in ("9999", "x"):
        wrong = changed_workbook(sheet, words, f't="s"><v>{index}</v>')
        yield Case(f"workbook, string of index {index}", wrong)
    yield Case("workbook, entities", changed_workbook(sheet, "<worksheet", ENTITY + "<worksheet"))
    used = changed_workbook(sheet, "<t>frame</t>", "<t>&amp;frame;</t>")
    yield Case("workbook, escapes", used)
    yield Case(
        "workbook, no such part", changed_workbook("xl/workbook.xml", 'r:id="rId1"', 'r:id="rId9"')
    )
    yield Case("old workbook", text(bytes.fromhex("d0cf11e0a1b11ae1") + bytes(512), "t.xls"))


def parquet(**changes: Any) -> Write:
    rows = of_numbers()
    columns = {name: [row[i] for row in rows] for i, name in enumerate(LONG)}
    wanted = {key: value(len(rows)) for key, value in changes.items()}
    table = pd.DataFrame(columns | wanted)
    return saved("t.parquet", lambda path: table.to_parquet(path, row_group_size=16))


def categories(count: int) -> Any:
    return pd.Categorical(np.tile(["b", "a"], count // 2))


def of_parquet() -> Iterator[Case]:
    def numbers(kind: str) -> Callable[[int], Any]:
        return lambda count: np.arange(count).astype(kind)

    yield Case("parquet", parquet())
    for kind in ("float32", "float16", "int16", "uint64", "bool"):
        yield Case(f"parquet, {kind}", parquet(x=numbers(kind)))
    gaps = {"y": lambda count: [*range(count - 1), None]}
    yield Case("parquet, gaps and categories", parquet(id=categories, **gaps))
    yield Case("parquet, whole names", parquet(id=lambda count: np.tile([7, 10], count // 2)))
    yield Case("parquet, a name missing", parquet(id=lambda count: ["a", None] * (count // 2)))
    yield Case("parquet, text", parquet(x=lambda count: ["1"] * count))
    yield Case("parquet, too large", parquet(x=lambda count: [0, 2**53 + 1] * (count // 2)))
    yield Case("parquet, records", parquet(x=lambda count: [{"a": 1}] * count))
    yield Case("parquet, a frame below 0", parquet(frame=lambda count: [-1] * count))
    yield Case("parquet, frame twice", parquet(frame=lambda count: [0] * count))
    yield Case("parquet, no clock", parquet(frame=lambda count: [None] * count))
    moments = np.datetime64("2024-05-01") + np.arange(FRAMES).repeat(2) * np.timedelta64(40, "ms")
    yield Case(
        "parquet, dates", parquet(frame=lambda count: moments), "long-table", {"time": "frame"}
    )


def array(value: Any, name: str = "a.npy") -> Write:
    return saved(name, lambda path: np.save(path, value, allow_pickle=True))


def archive(name: str = "a.npz", **arrays: Any) -> Write:
    return saved(name, lambda path: np.savez(path, **arrays))


def mat(packed: bool = False, **arrays: Any) -> Write:
    return saved("a.mat", lambda path: savemat(path, arrays, do_compression=packed))


def of_arrays() -> Iterator[Case]:
    whole = np.round(BODIES).astype(np.int16)
    for word, value in {
        "doubles": BODIES, "singles": BODIES.astype(np.float32), "whole": whole, "pose": POSE,
        "one animal": BODIES[:, 0], "one axis": BODIES[:, 0, 0], "complex": BODIES + 1j,
        "truth values": BODIES > 50, "objects": np.array([{"a": 1}], dtype=object),
        "big-endian": BODIES.astype(">f8"), "columns": np.asfortranarray(BODIES), "none": BODIES[:0],
        "dates": np.zeros(3, "M8[s]"), "records": np.zeros(3, "i4, f8"), "three": np.zeros((9, 2, 3)),
    }.items():  # fmt: skip
        yield Case(f"npy, {word}", array(value))
    axes = {"axes": ["individual", "xy", "frame"], "names": ["a", "b"]}
    yield Case("npy, axes", array(BODIES.transpose(1, 2, 0)), None, axes)
    yield Case("npy, wrong axes", array(BODIES), None, axes)
    yield Case("npy, too few names", array(BODIES), None, {"names": ["a"]})
    yield Case("npz, two", archive(a=BODIES, b=BODIES), "numpy")
    yield Case("npz, all", archive(a=BODIES, b=BODIES), "numpy", {"key": "*"})
    yield Case("npz, no such key", archive(a=BODIES, b=BODIES), "numpy", {"key": "c"})
    yield Case("npz, objects", archive(a=np.array([None, 1], dtype=object)), "numpy")
    trajectories = {"trajectories": BODIES, "frames_per_second": 25.0}
    yield Case("idtracker with gaps", array(np.array(trajectories), "with_gaps.npy"))
    for packed in (False, True):
        values = {"whole": whole, "text": "abc", "cell": np.array([1, "x"], dtype=object)}
        yield Case(f"mat, whole numbers, packed {packed}", mat(packed, **values))
        yield Case(f"mat, two, packed {packed}", mat(packed, a=BODIES, b=POSE), None, {"key": "b"})
    yield Case("mat, two, no key", mat(a=BODIES, b=POSE))
    yield Case("mat, structure", mat(s={"a": BODIES}))
    yield Case("mat, complex", mat(a=BODIES + 1j))
    yield Case("mat, none", mat(text="abc"))
    for word, (old, new) in {
        "kind": (bytes([9, 0, 0, 0, 0, 5]), bytes([12, 0, 0, 0, 0, 5])),
        "class": (bytes([6, 0, 0, 0, 8, 0, 0, 0, 6]), bytes([6, 0, 0, 0, 8, 0, 0, 0, 14])),
    }.items():  # fmt: skip

        def other(folder: Path, old: bytes = old, new: bytes = new) -> Path:
            path = write_mat(folder)
            path.write_bytes(path.read_bytes().replace(old, new, 1))
            return path

        yield Case(f"mat, other {word}", other)


def table_cases() -> Iterator[Case]:
    """Every file that a tracker's own format does not explain."""
    for name, kind in KINDS.items():
        yield Case(f"kind {name}", kind.write, kind.source if name == "movement" else None)
    for made in (
        of_text, of_times, of_cells, of_headers, of_damage, of_workbooks, of_parquet, of_arrays,
    ):  # fmt: skip
        yield from made()
