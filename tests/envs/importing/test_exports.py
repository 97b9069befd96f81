"""Tables as programs and people export them: each is read as it is, with pandas' own numbers.

Every case writes a file in the way of its program, and says how pandas reads it when it is told all
that the reader has to find out by itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
from commands import animarl
from numpy.typing import NDArray
from refusals import refuses

from animarl_envs.importing.readers import find_reader, get_reader, read, read_tracks
from animarl_envs.importing.tracks import merge
from tools.fuzz.layouts import BODIES

RATE = 25.0
COUNT = len(BODIES)
WHO = ("female", "male")
ISO = pd.Timestamp("2024-05-01 10:00:00") + pd.to_timedelta(np.arange(COUNT) / RATE, unit="s")


def long(**names: str) -> pd.DataFrame:
    """Columns frame, time, id, x, y under other names; those not named are left out."""
    columns = {
        "frame": np.repeat(np.arange(COUNT), 2), "time": np.repeat(np.arange(COUNT), 2) / RATE,
        "iso": np.repeat(ISO, 2), "id": np.tile(WHO, COUNT), "number": np.tile([0, 1], COUNT),
        "x": BODIES[..., 0].ravel(), "y": BODIES[..., 1].ravel(),
        "score": np.tile([0.9, 0.95], COUNT),
    }  # fmt: skip
    return pd.DataFrame({new: columns[old] for old, new in names.items()})


def wide(**names: str) -> pd.DataFrame:
    """Columns frame, time, x0, y0, x1, y1 under other names."""
    columns = {"frame": np.arange(COUNT), "time": np.arange(COUNT) / RATE, "iso": ISO}
    columns |= {f"{axis}{i}": BODIES[:, i, k] for i in (0, 1) for k, axis in enumerate("xy")}
    return pd.DataFrame({new: columns[old] for old, new in names.items()})


@dataclass(frozen=True)
class Export:
    """A file: how it is written, how pandas reads it, and which columns it then has.

    ``columns`` are clock, individual, x and y of a long table, pairs of x and y of a wide one.
    """

    write: Callable[[Path], object]
    columns: tuple[Any, ...]
    name: str = "export.csv"
    pandas: dict[str, Any] = field(default_factory=dict)
    unit: str = "px"
    timed: bool = True  # whether the frame rate is in the file

    def expected(self, path: Path) -> NDArray[np.float64]:
        """Positions ``(frames, individuals, 2)`` by pandas."""
        if path.suffix == ".xlsx":
            table = pd.read_excel(path, **self.pandas)
        else:
            table = pd.read_csv(path, float_precision="round_trip", **self.pandas)
        if isinstance(self.columns[0], tuple):
            return np.stack([table[list(pair)].to_numpy(float) for pair in self.columns], axis=1)
        clock, who, x, y = self.columns
        return np.stack(
            [table.pivot(index=clock, columns=who, values=v).to_numpy(float) for v in (x, y)],
            axis=2,
        )


def saved(table: pd.DataFrame, **how: Any) -> Callable[[Path], object]:
    return lambda path: table.to_csv(path, **{"index": False} | how)


def ethovision(path: Path) -> None:
    """A subject, semicolons at the ends of lines, ``-`` where it was not found."""
    lines = [
        '"Number of header lines:";"9";', '"Experiment";"Two arenas";', '"Trial name";"Trial 1";',
        '"Arena name";"Arena 1";', '"Subject name";"Subject 1";', '"Sample rate";"25,00";', "",
        '"Trial time";"Recording time";"X center";"Y center";"Area";"Velocity";',
        '"s";"s";"cm";"cm";"cm²";"cm/s";',
    ]  # fmt: skip
    for t, (x, y) in enumerate(BODIES[:, 0]):
        cells = [f"{t / RATE:.3f}", f"{t / RATE + 2:.3f}", f"{x:.4f}", f"{y:.4f}", "3.1", "-"]
        if t == 7:
            cells[2:5] = ["-", "-", "-"]
        lines.append(";".join(cells).replace(".", ",") + ";")
    path.write_text("\r\n".join(lines) + "\r\n", encoding="utf-16")


def ethovision_workbook(path: Path) -> None:
    """A sheet for each subject."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for i, who in enumerate(WHO):
        sheet = book.create_sheet(f"Track-Arena 1-{who}")
        for row in (
            ["Number of header lines:", "6"], ["Trial name", "Trial 1"], ["Subject name", who],
            [], ["Trial time", "X center", "Y center", "In zone"], ["s", "mm", "mm", None],
        ):  # fmt: skip
            sheet.append(row)
        for t, (x, y) in enumerate(BODIES[:, i].tolist()):
            sheet.append([t / RATE, x, y, 1])
    book.save(path)


def trackmate(path: Path) -> None:
    """Four header rows: names, full names, short names, units."""
    table = long(number="TRACK_ID", score="QUALITY", x="POSITION_X", y="POSITION_Y",
                 time="POSITION_T", frame="FRAME")  # fmt: skip
    table.insert(0, "LABEL", [f"ID{i}" for i in range(len(table))])
    table.insert(1, "ID", range(len(table)))
    head, rows = table.to_csv(index=False).split("\n", 1)
    more = (
        "Label,Spot ID,Track ID,Quality,X,Y,T,Frame\nLabel,Spot ID,Track ID,Quality,X,Y,T,Frame\n"
        ",,,(quality),(micron),(micron),(sec),\n"
    )
    path.write_text(f"{head}\n{more}{rows}")


def merged_cells(path: Path) -> None:
    """Two header rows of a spreadsheet, the animals' names once each over two columns."""
    table = wide(time="time", x0="a", y0="b", x1="c", y1="d")
    rows = table.to_csv(index=False, header=False)
    path.write_text(f",male,,female,\ntime,x,y,x,y\n{rows}")


def tables(**how: Any) -> Callable[[Path], object]:
    table = long(frame="Frame", id="Animal", x="X (mm)", y="Y (mm)")
    return lambda path: table.to_excel(path, index=False, **how)


LONG = long(frame="frame", id="id", x="x", y="y")
TIMED = long(time="time", id="individual", x="x", y="y")
PLAIN = ("frame", "id", "x", "y")
EXPORTS = {
    "pandas": Export(saved(LONG), PLAIN, timed=False),
    "units in the names": Export(
        saved(long(time="t [ms]", id="Animal ID", x="x (mm)", y="y (mm)").assign(
            **{"t [ms]": np.repeat(np.arange(COUNT), 2) * 40})),
        ("t [ms]", "Animal ID", "x (mm)", "y (mm)"), unit="mm",
    ),
    "ctrax": Export(
        saved(long(frame="frame", time="timestamp", number="identity", x="x_pos", y="y_pos")),
        ("frame", "identity", "x_pos", "y_pos"),
    ),
    "TrackMate": Export(
        trackmate, ("FRAME", "TRACK_ID", "POSITION_X", "POSITION_Y"),
        pandas={"skiprows": [1, 2, 3]}, unit="um",
    ),
    "a workbook with lines before": Export(
        tables(startrow=4), ("Frame", "Animal", "X (mm)", "Y (mm)"), "a.xlsx", {"skiprows": 4},
        unit="mm", timed=False,
    ),
    "wide with capitals and units": Export(
        saved(wide(time="Time (s)", x0="X1 (cm)", y0="Y1 (cm)", x1="X2 (cm)", y1="Y2 (cm)"),
              sep=";", decimal=","),
        (("X1 (cm)", "Y1 (cm)"), ("X2 (cm)", "Y2 (cm)")), pandas={"sep": ";", "decimal": ","},
        unit="cm",
    ),
    "merged cells": Export(
        merged_cells, (("a", "b"), ("c", "d")),
        pandas={"skiprows": 2, "names": ["time", "a", "b", "c", "d"]},
    ),
    "one animal": Export(
        saved(wide(time="t_s", x0="Centroid X", y0="Centroid Y")), (("Centroid X", "Centroid Y"),)
    ),
    "EthoVision": Export(
        ethovision, (("X center", "Y center"),), "Track-Trial 1-Subject 1.txt",
        {"sep": ";", "decimal": ",", "skiprows": [*range(7), 8], "encoding": "utf-16",
         "na_values": ["-"], "skip_blank_lines": False},
        unit="cm",
    ),
    "EthoVision in a workbook": Export(
        ethovision_workbook, (("X center", "Y center"),), "Raw data-Trial 1.xlsx",
        {"skiprows": [0, 1, 2, 3, 5], "sheet_name": 0}, unit="mm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", EXPORTS)
def test_exports_have_the_numbers_of_pandas_and_are_imported_by_one_command(
    kind: str, tmp_path: Path
) -> None:
    export = EXPORTS[kind]
    path, out = tmp_path / export.name, tmp_path / "demos.npz"
    export.write(path)
    found = read_tracks(path)
    np.testing.assert_array_equal(found[0].bodies, export.expected(path), strict=True)
    assert found[0].unit == export.unit
    assert found[0].frame_rate == (RATE if export.timed else None)
    rate = [] if export.timed else ["--fps", "25"]
    animarl("import", path, *rate, "--out", out)
    demos = read(out)
    (tracks,) = merge(found)  # of a workbook with a sheet for each animal
    assert set(demos.individuals) == set(tracks.individuals)
    assert demos.dt == pytest.approx(1 / RATE) and demos.provenance["unit"] == export.unit


def test_exports_in_pieces_of_a_second_clock_are_laid_side_by_side(tmp_path: Path) -> None:
    """Two subjects of a trial in two files; the second was found ten frames later."""
    paths = []
    for i, late in ((0, 0), (1, 10)):
        path = tmp_path / f"Subject {i}.txt"
        rows = [f"{t / RATE},{x!r},{y!r}" for t, (x, y) in enumerate(BODIES[:, i].tolist())]
        head = ['"Number of header lines:","5"', '"Trial name","T"', f'"Subject name","s{i}"']
        path.write_text("\n".join([*head, "Trial time,X center,Y center", "s,cm,cm", *rows[late:]])
                        + "\n")  # fmt: skip
        paths.append(path)
    (both,) = merge([tracks for path in paths for tracks in read_tracks(path)])
    assert both.individuals == ("s0", "s1")
    np.testing.assert_array_equal(both.bodies[:, 0], BODIES[:, 0])
    np.testing.assert_array_equal(both.bodies[10:, 1], BODIES[10:, 1])
    assert np.isnan(both.bodies[:10, 1]).all()


def test_exports_take_a_decimal_sign_as_typed_in_a_shell(tmp_path: Path) -> None:
    saved(TIMED, sep=";", decimal=",")(tmp_path / "t.csv")
    animarl("import", tmp_path / "t.csv", "--option", "decimal=,", "--dry-run")


@pytest.mark.parametrize("title", ["Experiment 5,,", "Experiment,5,", ",,", "Experiment 5"])
def test_exports_with_a_title_keep_their_frames(title: str, tmp_path: Path) -> None:
    """Of three columns a title is padded to as many cells as the header has."""
    (tmp_path / "t.csv").write_text(f"{title}\nframe,x,y\n0,,\n1,1.5,2\n4,4.5,5\n")
    (tracks,) = read_tracks(tmp_path / "t.csv")
    assert tracks.individuals == ("individual_0",) and len(tracks) == 5
    assert np.flatnonzero(np.isfinite(tracks.bodies[:, 0, 0])).tolist() == [1, 4]


GAPS = (0, 1, 2, 3, 7, 8)  # frames that are left


@pytest.mark.parametrize(
    ("clock", "said"),
    [
        ("index", "first column, 'index', rises"), ("", "first column, '', rises"),
        ("Time since start", "before line 6 some are missing"),
        ("t,time", "several of its columns may be of time"),
        ("frame,frame_id", "several of its columns may be of frame"), ("time (h)", ""),
        ("Time [hh:mm:ss]", ""), ("Frame (n)", ""), ("temperature", ""),
    ],
)  # fmt: skip
def test_exports_of_one_animal_lose_no_gap_whatever_their_clock_is_called(
    clock: str, said: str, tmp_path: Path
) -> None:
    cells = {"time (h)": "{h}", "Time [hh:mm:ss]": "0:00:0{t}", "temperature": "20"}
    cell = cells.get(clock, ",".join(["{t}"] * (1 + clock.count(","))))
    rows = [f"{cell.format(t=t, h=f'{t / 90000:.9f}')},{t},{t}\n" for t in GAPS]
    path = tmp_path / "t.csv"
    path.write_text(f"{clock},x,y\n{''.join(rows)}")
    if said:
        refuses(said, read_tracks, path)
        return
    (tracks,) = read_tracks(path)
    x = tracks.bodies[:, 0, 0]
    assert x[np.isfinite(x)].tolist() == list(GAPS)
    assert len(tracks) == (6 if clock == "temperature" else 9)


def test_exports_are_named_as_their_file_with_or_without_an_ending(tmp_path: Path) -> None:
    for name in ("session1", "session1.csv", "session1.a.txt"):
        (tmp_path / name).write_text("frame,id,x,y\n0,a,0,0\n1,a,1,1\n")
        (tracks,) = read_tracks(tmp_path / name, "long-table")
        assert tracks.recording == name.removesuffix(".csv").removesuffix(".txt")


def test_exports_of_one_animal_each_are_merged(tmp_path: Path) -> None:
    """DeepLabCut's name of a file ends in that of its network."""
    paths = []
    for i, who in enumerate(WHO):
        path = tmp_path / f"pair1_{who}DLC_resnet50_x.csv"
        rows = [
            f"{t},{x!r},{y!r},{0.1 if t == 20 + 5 * i else 1.0}"
            for t, (x, y) in enumerate(BODIES[:, i].tolist())
        ]
        path.write_text("\n".join(["scorer,s,s,s", "bodyparts,nose,nose,nose",
                                   "coords,x,y,likelihood", *rows]) + "\n")  # fmt: skip
        paths.append(str(path))
    out = tmp_path / "demos.npz"
    merging = ("--fps", 25, "--merge-individuals")
    animarl("import", *paths, *merging, "--target", "male", "--out", out)
    demos = read(out)
    assert demos.individuals == WHO
    assert {name.partition("/")[0] for name in demos.recording.tolist()} == {"pair1"}
    assert demos.provenance["cleaning"]["pair1"]["below_confidence"] == 2
    refuses("two files or more", animarl, "import", paths[0], *merging, "--dry-run")


def test_exports_in_a_workbook_of_many_sheets_are_parsed_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Parsed anew for each sheet, a workbook of eight would take too long to be read."""
    ethovision_workbook(path := tmp_path / "Raw data-Trial 1.xlsx")
    parsed, read_excel = [], pd.read_excel
    monkeypatch.setattr(pd, "read_excel", lambda *a, **k: parsed.append(a) or read_excel(*a, **k))
    assert get_reader("ethovision").sniff(path)
    assert len(get_reader("ethovision").function(path)) == len(WHO)
    assert len(parsed) == 1


@pytest.mark.slow
def test_exports_in_workbooks_that_ask_for_too_much_are_refused(tmp_path: Path) -> None:
    """A lone cell at the far end of a sheet."""
    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = "frame", 1
    book.save(tmp_path / "far.xlsx")
    refuses(r"may ask for|more rows or columns", find_reader, tmp_path / "far.xlsx")
