"""Readers refuse what is absurd, hostile or incomplete, in one sentence.

Damaged tables, and files whose sentence is known whole, are in the golden table of files.
"""

import io
import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused, refuses

from animarl_envs import wall
from animarl_envs.arena import Arena
from animarl_envs.errors import InputError
from animarl_envs.files import load_npy
from animarl_envs.importing.readers import read, read_tracks
from animarl_envs.importing.readers.authors import load_plain
from tools.fuzz.layouts import write_native, write_npy


def test_readers_refuse_text_truncation_folders_and_absence(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not an archive")
    whole = write_native(tmp_path)
    (tmp_path / "cut.npz").write_bytes(whole.read_bytes()[:-200])
    for name in ("text.npz", "cut.npz"):
        for source in (None, "animarl", "agents", "numpy", "trex"):
            refuses(name, read, tmp_path / name, source)
    refuses("no such file", read, tmp_path / "absent.npz")
    with pytest.raises(InputError):
        read(tmp_path, "animarl")
    refuses("source 'nonsense' is unknown", read, whole, "nonsense")
    with pytest.raises(InputError, match="holds no episode"):
        read(whole).select(split="train", condition=1)


@pytest.mark.parametrize("source", [None, "animarl"])
def test_readers_say_what_is_empty_cut_short_or_a_folder(
    source: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "a.npz"
    path.touch()
    assert "a.npz: it is empty" in refused(path, source)
    path.write_bytes(write_native(tmp_path).read_bytes()[:-200])
    assert "a.npz: it is not a plain npz archive, or damaged or cut short" in refused(path, source)
    assert f"{tmp_path}: it is a folder" in refused(tmp_path, source)


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


@pytest.mark.parametrize("protocol", [3, 4])
def test_only_plain_objects_are_unpickled(protocol: int, tmp_path: Path) -> None:
    plain = {"a": [1, (2.5, "x")], "b": np.arange(6.0).reshape(2, 3), "c": np.float64(2.0)}
    found = load_plain(pickle.dumps(plain, protocol=protocol), "file")
    np.testing.assert_array_equal(found["b"], plain["b"])
    assert found["a"] == [1, (2.5, "x")] and found["c"] == 2.0
    for hostile in (os.system, Path("x"), Arena(), io.StringIO("x")):
        with pytest.raises(InputError, match="pickle that is damaged or not of numbers and lists"):
            load_plain(pickle.dumps({"a": hostile}, protocol=max(protocol, 2)), "file")


class _Allocates:
    def __reduce__(self) -> tuple[Any, ...]:
        return np.ndarray, ((10**12,),)


def test_unpickling_calls_no_constructor_that_allocates() -> None:
    refuses("pickle", load_plain, pickle.dumps(_Allocates()), "file")
    many = b"\x80\x05\x96" + (2**40).to_bytes(8, "little") + b"."
    refuses("pickle", load_plain, many, "file")


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


def test_a_frame_rate_is_asked_for_where_the_file_has_none(tmp_path: Path) -> None:
    refuses("give it with --fps", read, write_npy(tmp_path))


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
    import pyarrow as pa
    import pyarrow.parquet as pq

    path, zeros = tmp_path / "bomb.parquet", pa.array(np.zeros(1_000_000))
    columns = {name: zeros for name in ("frame", "x", "y")}
    columns["id"] = pa.array(["a"] * 1_000_000).dictionary_encode()
    table = pa.table(columns)
    with pq.ParquetWriter(path, table.schema) as writer:
        for _ in range(40):
            writer.write_table(table)
    refuses("more memory than a file of its size", read_tracks, path, "long-table")
