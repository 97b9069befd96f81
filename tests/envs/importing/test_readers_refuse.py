"""Readers refuse what is absurd, hostile or incomplete, in one sentence; no wrong number passes.

Damaged tables, and files whose sentence is known whole, are in the golden table of files.
"""

import io
import pickle
import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from refusals import refused, refuses

from animarl_envs import wall
from animarl_envs.errors import InputError, SeveralFaultsError
from animarl_envs.files import load_npy
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.plain_pickle import load_plain
from animarl_envs.importing.readers import follow, read, read_tracks
from tools.fuzz.layouts import KINDS, write_native, write_npy, write_termites, write_wide


def test_readers_refuse_text_truncation_folders_and_absence(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not an archive")
    (tmp_path / "empty.npz").touch()
    whole = write_native(tmp_path)
    (tmp_path / "cut.npz").write_bytes(whole.read_bytes()[:-200])
    for source in (None, "animarl", "agents", "numpy", "trex"):
        refuses("text.npz", read, tmp_path / "text.npz", source)
        refuses("empty.npz: it is empty", read, tmp_path / "empty.npz", source)
        refuses("cut.npz: it is not a plain npz|cut short", read, tmp_path / "cut.npz", source)
    for source in (None, "animarl"):
        refuses(f"{tmp_path}: it is a folder", read, tmp_path, source)
    refuses("no such file", read, tmp_path / "absent.npz")
    refuses("source 'nonsense' is unknown", read, whole, "nonsense")
    refuses("give it with --fps", read, write_npy(tmp_path))


def test_readers_refuse_headers_that_ask_for_too_much(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3, 2)}
    )
    (tmp_path / "huge.npy").write_bytes(buffer.getvalue() + bytes(64))
    refuses("announces", read_tracks, tmp_path / "huge.npy", "numpy")
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("a.npy", buffer.getvalue() + bytes(64))
    refuses("announces", read_tracks, tmp_path / "huge.npz", "numpy")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(200 * 2**20))
    refuses("more than 64 times", read_tracks, tmp_path / "bomb.npz", "numpy")
    (tmp_path / "far.csv").write_text("frame,id,x,y\n0,a,0,0\n2000000000,a,1,1\n")
    refuses("more than 64 times", read_tracks, tmp_path / "far.csv", "long-table")


def test_a_pickle_that_repeats_itself_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wall, "MEMORY", 2**26)  # or filling a gigabyte takes a while
    laugh: list[Any] = [0.0]
    for _ in range(30):
        laugh = [laugh] * 10
    path = tmp_path / "pos_val_rep_2on1_indiv_equal_K_0.npz"
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "|O", "fortran_order": False, "shape": ()}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("pos.npy", buffer.getvalue() + pickle.dumps(laugh))
    refuses(r"MemoryError|more memory|processor time", read, path)
    assert load_npy(buffer.getvalue() + pickle.dumps([1]), path, unpickle=load_plain) == [1]


@pytest.mark.parametrize("header", ["frame,id,x,y", "frame,x_a,y_a"])
def test_frames_that_begin_again_are_a_second_session(header: str, tmp_path: Path) -> None:
    rows = [f"{t},a,{t},1" if "id" in header else f"{t},{t},1" for t in (0, 1, 2, 0, 1, 2)]
    (tmp_path / "t.csv").write_text("\n".join([header, *rows]) + "\n")
    assert "frames begin again at line 5, as of a second session" in refused(tmp_path / "t.csv")


def test_lines_are_counted_across_blocks_quotes_and_line_ends(tmp_path: Path) -> None:
    """A table of several blocks whose lines end as on Windows, with separators inside quotes."""
    rows = [f'{t},"a, the {i}",{t}.5,{i}.25\r\n' for t in range(30_000) for i in range(2)]
    text = "frame,id,x,y\r\n" + "".join(rows)
    assert len(text) > 2 * 2**20 - 400_000
    (tmp_path / "t.csv").write_bytes(text.encode())
    (tracks,) = read_tracks(tmp_path / "t.csv")
    assert tracks.individuals == ("a, the 0", "a, the 1")
    np.testing.assert_array_equal(tracks.bodies[:, 1, 0], np.arange(30_000) + 0.5)
    spoilt = text.replace("25000.5,1.25", "25000.5;1.25")
    (tmp_path / "t.csv").write_bytes(spoilt.encode())
    refuses("line 50003 has 3 cells, the header 4", read_tracks, tmp_path / "t.csv")


def test_parquet_reader_refuses_rows_beyond_what_the_file_may_ask_for(tmp_path: Path) -> None:
    """40 million equal rows shrink to a few kilobytes: no tracks do, so it is a bomb."""
    path, zeros = tmp_path / "bomb.parquet", pa.array(np.zeros(1_000_000))
    columns = {name: zeros for name in ("frame", "x", "y")}
    columns["id"] = pa.array(["a"] * 1_000_000).dictionary_encode()
    table = pa.table(columns)
    with pq.ParquetWriter(path, table.schema) as writer:
        for _ in range(40):
            writer.write_table(table)
    refuses("more memory than a file of its size", read_tracks, path, "long-table")


TEXTS = sorted(name for name, kind in KINDS.items() if kind.guard == "text")


@pytest.mark.parametrize("name", TEXTS)
def test_last_number_of_a_cut_text_is_right_or_left_out(name: str, tmp_path: Path) -> None:
    """Cut anywhere in the last number, and right behind it."""
    kind = KINDS[name]
    path = kind.write(tmp_path)
    whole = path.read_bytes().rstrip(b"\r\n")
    expected = read_tracks(path, kind.source)
    for lost in (0, 1, 3, 7, 13, 16):
        path.write_bytes(whole[: len(whole) - lost])
        try:
            found = read_tracks(path, kind.source)
        except InputError as error:
            assert re.search(
                "no line ending|cells, the header|has no|no number|is earlier", str(error)
            )
            continue
        for one, right in zip(found, expected, strict=True):
            there = np.isfinite(one.positions)
            assert np.count_nonzero(np.isfinite(right.positions) & ~there) <= 1
            np.testing.assert_allclose(one.positions[there], right.positions[there], atol=0.1)


def test_wrong_number_at_the_end_of_tables_beside_is_refused(tmp_path: Path) -> None:
    path = write_termites(tmp_path)
    index = tmp_path / "index.csv"
    index.write_text(index.read_text().rstrip("\n")[:-1])
    refuses("no line ending", read_tracks, path)
    events = tmp_path / "events.csv"
    events.write_text("recording,start,end\nwide,0,1.5")
    recipe = ImportRecipe(frame_rate=20.0, cutting=Cutting(mode="events", events=str(events)))
    refuses("no line ending", follow, recipe, [write_wide(tmp_path)])


def test_short_stretches_are_counted_and_do_not_hide_the_contact(tmp_path: Path) -> None:
    """Thirteen of one step each were dropped without a word, and no contact was found."""
    rng, lines = np.random.default_rng(0), ["recording,frame,id,x,y"]
    for number in range(8):
        near = np.concatenate([rng.uniform(20, 90, 29), [5.0]])
        for t, gap in enumerate(near):
            lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,{gap},{t % 3}"]
        for start in (40, 50):  # two frames in which both are seen
            for t in (start, start + 1):
                lines += [f"r{number},{t},hare,0,0", f"r{number},{t},hunter,70,{t % 3}"]
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines) + "\n")
    demos = read(path, frame_rate=25.0, target="hare")
    assert demos.num_episodes == 8 and (demos.outcome == 1).all()
    assert all(one["too_short"] == 2 for one in demos.provenance["cleaning"].values())


def test_one_import_lists_the_faults_of_all_lines_and_files(tmp_path: Path) -> None:
    cells, rows = tmp_path / "cells.csv", tmp_path / "rows.csv"
    cells.write_text("frame,id,x,y\n0,a,1,2\n1,a,x1,2\n2,a,1,2,3\n3,a,1,z\n4,a,1,2\n")
    double = [f"{r},{f},p,1,2\n{r},{f},p,1,2" for r in "AB" for f in range(8)]
    rows.write_text("recording,frame,id,x,y\n" + "\n".join(double) + "\n")
    with pytest.raises(SeveralFaultsError) as refused:
        follow(ImportRecipe(target=None, frame_rate=10.0), [cells, rows])
    lines = str(refused.value).splitlines()
    assert [line.split(" ")[1:3] for line in lines[:3]] == [["line", n] for n in ("3,", "4", "5,")]
    assert "B, frame 0" not in lines[10] and lines[10] == "and 9 more" and len(lines) == 11
    assert pickle.loads(pickle.dumps(refused.value)).args == refused.value.args
