"""Tables as programs and people export them: each is read as it is, with pandas' own numbers.

Every case writes a file in the way of its program, and says how pandas reads it when it is told all
that the reader has to find out by itself.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from commands import animarl
from numpy.typing import NDArray
from refusals import refuses

from animarl_envs.importing.readers import find_reader, read, read_tracks
from animarl_envs.importing.tracks import merge
from tools.fuzz.layouts import BODIES

RATE = 25.0
COUNT = len(BODIES)
WHO = ("female", "male")
ISO = pd.Timestamp("2024-05-01 10:00:00") + pd.to_timedelta(np.arange(COUNT) / RATE, unit="s")


def long(**names: str) -> pd.DataFrame:
    """Columns frame, time, id, x, y under other names; those not named are left out."""
    columns = {
        "frame": np.repeat(np.arange(COUNT), 2),
        "time": np.repeat(np.arange(COUNT), 2) / RATE,
        "iso": np.repeat(ISO, 2),
        "id": np.tile(WHO, COUNT),
        "number": np.tile([0, 1], COUNT),
        "x": BODIES[..., 0].ravel(),
        "y": BODIES[..., 1].ravel(),
        "score": np.tile([0.9, 0.95], COUNT),
    }
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
    import openpyxl

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
SPOKEN = ("time", "individual", "x", "y")
GERMAN = long(time="Zeit", id="Tier", x="X", y="Y")
EXPORTS = {
    "pandas": Export(saved(LONG), PLAIN, timed=False),
    "pandas with an index": Export(saved(LONG, index=True), PLAIN, timed=False),
    "R write.csv": Export(saved(LONG, quoting=2), PLAIN, timed=False),
    "R write.csv2": Export(
        saved(TIMED, sep=";", decimal=","), SPOKEN, pandas={"sep": ";", "decimal": ","}
    ),
    "tabs in txt": Export(saved(TIMED, sep="\t"), SPOKEN, "a.txt", {"sep": "\t"}),
    "tabs in xls": Export(saved(TIMED, sep="\t"), SPOKEN, "a.xls", {"sep": "\t"}),
    "blanks": Export(
        lambda path: path.write_text(TIMED.to_string(index=False) + "\n"), SPOKEN, "a.txt",
        {"sep": r"\s+"},
    ),
    "Excel with a byte order mark": Export(
        saved(GERMAN, sep=";", decimal=",", encoding="utf-8-sig"), ("Zeit", "Tier", "X", "Y"),
        pandas={"sep": ";", "decimal": ","},
    ),
    "Excel's Unicode text": Export(
        saved(TIMED, sep="\t", encoding="utf-16"), SPOKEN, "a.txt",
        {"sep": "\t", "encoding": "utf-16"},
    ),
    "Latin-1": Export(
        saved(GERMAN.replace({"Tier": {"male": "Männchen"}}), encoding="latin-1"),
        ("Zeit", "Tier", "X", "Y"), pandas={"encoding": "latin-1"},
    ),
    "units in the names": Export(
        saved(long(time="t [ms]", id="Animal ID", x="x (mm)", y="y (mm)").assign(
            **{"t [ms]": np.repeat(np.arange(COUNT), 2) * 40})),
        ("t [ms]", "Animal ID", "x (mm)", "y (mm)"), unit="mm",
    ),
    "ISO times": Export(
        saved(long(iso="timestamp", id="animal", x="pos_x", y="pos_y")),
        ("timestamp", "animal", "pos_x", "pos_y"),
    ),
    "ISO times of several digits": Export(
        saved(long(iso="Date time", id="Mouse", x="X", y="Y"), date_format="%Y-%m-%dT%H:%M:%S.%fZ"),
        ("Date time", "Mouse", "X", "Y"),
    ),
    "ctrax": Export(
        saved(long(frame="frame", time="timestamp", number="identity", x="x_pos", y="y_pos")),
        ("frame", "identity", "x_pos", "y_pos"),
    ),
    "a multi-object tracker": Export(
        saved(long(frame="frame_id", number="track_id", x="cx", y="cy", score="confidence")),
        ("frame_id", "track_id", "cx", "cy"), timed=False,
    ),
    "TrackMate": Export(
        trackmate, ("FRAME", "TRACK_ID", "POSITION_X", "POSITION_Y"),
        pandas={"skiprows": [1, 2, 3]}, unit="um",
    ),
    "a workbook": Export(tables(), ("Frame", "Animal", "X (mm)", "Y (mm)"), "a.xlsx", unit="mm",
                         timed=False),
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
    "wide with ISO times": Export(
        saved(wide(iso="timestamp", x0="a_x", y0="a_y", x1="b_x", y1="b_y"), sep="\t"),
        (("a_x", "a_y"), ("b_x", "b_y")), "a.tsv", {"sep": "\t"},
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


def test_exports_of_several_recordings_are_told_apart_and_begin_at_their_own_times(
    tmp_path: Path,
) -> None:
    """``recording,time,individual,x,y``, the second recording hours after the first."""
    table = pd.concat(
        [TIMED.assign(recording=name, time=TIMED.time + start)
         for name, start in (("day 1", 2286.0), ("day 2", 90_000.0))]
    )[["recording", "time", "individual", "x", "y"]]  # fmt: skip
    table.to_csv(tmp_path / "two.csv", index=False)
    first, second = read_tracks(tmp_path / "two.csv")
    assert (first.recording, second.recording) == ("day 1", "day 2")
    for tracks in (first, second):
        assert tracks.frame_rate == RATE and np.isfinite(tracks.bodies).all()
        np.testing.assert_array_equal(tracks.bodies, BODIES[:, ::1][:, [0, 1]])


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


UNCLEAR = {
    "names of nobody": ("a,b,c,d\n0,m,1,2\n1,m,2,3\n", "--option frame=a --option individual=b"),
    "two pairs": (
        "frame,id,x_centroid,y_centroid,x_center,y_center\n0,a,1,2,3,4\n", "--option x="
    ),
    "two identities": ("frame,animal,track_id,x,y\n0,a,7,1,2\n", "--option individual="),
    "no times": ("animal,x,y\na,1,2\na,2,3\n", "--source long-table"),
}  # fmt: skip


@pytest.mark.parametrize("kind", UNCLEAR)
def test_exports_that_are_not_clear_are_refused_with_the_command(kind: str, tmp_path: Path) -> None:
    text, part = UNCLEAR[kind]
    (tmp_path / "un clear.csv").write_text(text)
    said = refuses("", read_tracks, tmp_path / "un clear.csv")
    assert part in said and f"animarl import '{tmp_path}/un clear.csv'" in said
    for column in text.split("\n")[0].split(","):
        assert column in said


def test_exports_with_letters_for_animals_are_told_from_units(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    letters = wide(frame="frame", x0="x_m", y0="y_m", x1="x_f", y1="y_f")
    for table in (letters, letters.assign(recording="r")):  # where a long table might be seen
        table.to_csv(path, index=False)
        (tracks,) = read_tracks(path)
        assert tracks.individuals == ("m", "f") and tracks.unit == "px"
    wide(frame="frame", x0="x_m", y0="y_m").to_csv(path, index=False)
    (tracks,) = read_tracks(path)
    assert tracks.individuals == ("individual_0",) and tracks.unit == "m"


@pytest.mark.parametrize("recording", [{}, {"recording": "r"}])
@pytest.mark.parametrize("first", ["x_mm,y_mm", "x,y", "X (cm),Y (cm)"])
def test_exports_with_a_pair_left_over_are_refused(
    first: str, recording: dict[str, str], tmp_path: Path
) -> None:
    path, (x, y) = tmp_path / "t.csv", first.split(",")
    table = wide(frame="frame", x0=x, y0=y, x1="x_f", y1="y_f").assign(**recording)
    table.to_csv(path, index=False)
    said = refuses(r"t\.csv: columns 'x_f' and 'y_f' are left over", read_tracks, path)
    columns = yaml.safe_load(said.partition("'columns=")[2].partition("'")[0])
    (tracks,) = read_tracks(path, "wide-table", columns=columns)
    np.testing.assert_array_equal(tracks.bodies, BODIES)
    moving = {"x_f": "velocity_x", "y_f": "velocity_y"}
    table.rename(columns=moving).to_csv(path, index=False)
    assert read_tracks(path)[0].individuals == ("individual_0",)


def test_exports_with_a_wrong_cell_are_refused_by_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    rows = [f"{t};a;{t},5;1,5" for t in range(20)]
    rows[11] = "11;a;eleven;1,5"
    path.write_text("# a tracker\n\nframe;id;x;y\n" + "\n".join(rows) + "\n")
    refuses("line 15, column 'x' holds 'eleven'", read_tracks, path)


def test_exports_take_a_decimal_sign_as_typed_in_a_shell(tmp_path: Path) -> None:
    saved(TIMED, sep=";", decimal=",")(tmp_path / "t.csv")
    animarl("import", tmp_path / "t.csv", "--option", "decimal=,", "--dry-run")


def test_exports_of_one_animal_each_are_merged(tmp_path: Path) -> None:
    """DeepLabCut's name of a file ends in that of its network."""
    paths = []
    for i, who in enumerate(WHO):
        path = tmp_path / f"pair1_{who}DLC_resnet50_x.csv"
        rows = [f"{t},{x!r},{y!r},1.0" for t, (x, y) in enumerate(BODIES[:, i].tolist())]
        path.write_text("\n".join(["scorer,s,s,s", "bodyparts,nose,nose,nose",
                                   "coords,x,y,likelihood", *rows]) + "\n")  # fmt: skip
        paths.append(str(path))
    out = tmp_path / "demos.npz"
    merging = ("--fps", 25, "--merge-individuals")
    animarl("import", *paths, *merging, "--target", "male", "--out", out)
    demos = read(out)
    assert demos.individuals == WHO
    assert {name.partition("/")[0] for name in demos.recording.tolist()} == {"pair1"}
    refuses("two files or more", animarl, "import", paths[0], *merging, "--dry-run")


def test_exports_in_workbooks_that_ask_for_too_much_are_refused(tmp_path: Path) -> None:
    """A lone cell at the far end of a sheet."""
    import openpyxl

    book = openpyxl.Workbook()
    book.active["A1"], book.active["XFD1048576"] = "frame", 1
    book.save(tmp_path / "far.xlsx")
    refuses(r"may ask for|more rows or columns", find_reader, tmp_path / "far.xlsx")
