"""Damaged files through every reader, hostile pickles through the restricted unpickler.

No code runs, no traceback, no silent wrong number; no object of NumPy's is touched by a pickle. The
damage and the judge are those of ``make fuzz`` (``tools/fuzz``).
"""

import io
import pickle
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.files import load_npy
from animarl_envs.importing.plain_pickle import load_plain
from animarl_envs.importing.readers import read
from tools.fuzz.judging import assert_true_to_the_file, read_values
from tools.fuzz.layouts import KINDS
from tools.fuzz.mutations import Damage
from tools.fuzz.targets import TARGETS
from tools.fuzz.workers import fuzz

FEW, MANY = 7, 80  # damaged files of each kind in the normal and in the slow run
LOST = Damage(b"", 0)
HARMLESS = {"ran": 0, "traceback": 0, "hang": 0}


def test_readers_withstand_damaged_files() -> None:
    result = fuzz(FEW * len(TARGETS), 1, 7, list(TARGETS))
    assert result.total == FEW * len(TARGETS) >= 200
    assert result.counts.items() >= (HARMLESS | {"unexplained": 0}).items(), result.findings
    assert result.counts["refused"] > result.total / 2


@pytest.mark.slow
def test_readers_withstand_many_damaged_files() -> None:
    result = fuzz(MANY * len(TARGETS), 1, 8, list(TARGETS))
    assert result.total == MANY * len(TARGETS) >= 2000
    assert result.counts.items() >= HARMLESS.items(), result.findings


def test_kinds_have_every_guard() -> None:
    assert {kind.guard for kind in KINDS.values()} == {"checksum", "text", "structure"}


def test_the_judge_notices_what_it_is_there_for(tmp_path: Path) -> None:
    """A reader that returns a number the file does not hold, or shifted ones, is caught."""
    path = KINDS["long"].write(tmp_path)
    clean = read_values(KINDS["long"], path)
    wrong = {key: value.copy() for key, value in clean.items()}
    wrong[next(iter(wrong))][3, 0, 0] += 1e-3
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, wrong, clean, LOST)
    with pytest.raises(AssertionError, match="checksums"):
        assert_true_to_the_file(KINDS["npz"], path, wrong, clean, replace(LOST, overwritten=5))
    with pytest.raises(AssertionError, match="has shifted the numbers"):
        assert_true_to_the_file(KINDS["npy"], path, wrong, clean, LOST)
    assert_true_to_the_file(KINDS["npy"], path, wrong, clean, replace(LOST, overwritten=1))
    shifted: dict[Any, Any] = {key: np.roll(value, 1) for key, value in clean.items()}
    with pytest.raises(AssertionError, match="too many numbers"):
        assert_true_to_the_file(KINDS["npy"], path, shifted, clean, replace(LOST, overwritten=1))
    with pytest.raises(AssertionError, match="is not in the file"):
        assert_true_to_the_file(KINDS["long"], path, shifted, clean, replace(LOST, overwritten=1))


DTYPE = b"cnumpy\ndtype\n"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR"
PLAIN = (b"S'f8'\nI0\nI1\ntR", b"(I3\nS'<'\nNNNI-1\nI-1\nI0\ntb")


def dtype(code: str, state: bytes = b"") -> bytes:
    return DTYPE + f"(S'{code}'\nI0\nI1\ntR".encode() + state


HOSTILE: dict[str, bytes] = {
    # A void of 8 bytes that is given a field of objects and no flags: its bytes would be addresses
    "object field": dtype(
        "V8", b"(I3\nS'|'\nN(S'f'\nt(dS'f'\n(" + dtype("O8") + b"I0\ntsI8\nI1\nI0\ntb"
    ),
    "plain with fields": dtype("f8", b"(I3\nS'|'\nN(S'f'\nt(dI8\nI1\nI0\ntb"),
    "void": dtype("V8"),
    "record": dtype("i4, O"),
    "date": dtype("M8[s]"),
    "long text": dtype("U9999999"),
    "state twice": dtype("f8", b"(I3\nS'<'\nNNNI-1\nI-1\nI0\ntb" * 2),
    "bare dtype": dtype("f8"),
    "array never filled": EMPTY,
    "too few bytes": EMPTY + b"(I1\n(I9\nt" + dtype("f8") + b"I0\nS'12345678'\ntb",
    "too many bytes": EMPTY + b"(I1\n(I1\nt" + dtype("i1") + b"I0\nS'12'\ntb",
    "negative shape": EMPTY + b"(I1\n(I-1\nI-1\nt" + dtype("i1") + b"I0\nS'1'\ntb",
    "huge shape": EMPTY + b"(I1\n(L4294967296L\nL4294967296L\nt" + dtype("i1") + b"I0\nS''\ntb",
    "too few objects": EMPTY + b"(I1\n(I9\nt" + dtype("O8") + b"I0\n(lI1\natb",
    "bytes as objects": EMPTY + b"(I1\n(I1\nt" + dtype("O8") + b"I0\nS'12345678'\ntb",
    "filled twice": EMPTY + (b"(I1\n(I1\nt" + dtype("i1") + b"I0\nS'1'\ntb") * 2,
    "no truth value": EMPTY + b"(I1\n(I1\nt" + dtype("b1") + b"I0\nS'\\x07'\ntb",
    "no character": EMPTY + b"(I1\n(I1\nt" + dtype("U1") + b"I0\nS'\\xff\\xff\\xff\\xff'\ntb",
    "object number": b"cnumpy.core.multiarray\nscalar\n(" + dtype("O8") + b"S'12345678'\ntR",
    "short number": b"cnumpy.core.multiarray\nscalar\n(" + dtype("f8") + b"S'1'\ntR",
    "state of a function": b"c_codecs\nencode\n(dS'__code__'\nI1\nsb",
    "state of a list": b"(l(dS'a'\nI1\nsb",
    "call of a list": b"(l(tR",
    "call of what was made": dtype("f8") + b"(tR",
    "bare function": b"c_codecs\nencode\n",
    "bare class": b"cnumpy\nndarray\n",
    "call that allocates": b"cnumpy\nndarray\n((L1000000000000L\nttR",
    "bytes without end": b"\x80\x05\x96" + (2**40).to_bytes(8, "little"),
    "float key": b"(dF1.5\nI1\ns",
    "deep": b"(" * 500 + b"t" * 500,
}  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
def test_unpickling_admits_plain_stand_ins_only(kind: str) -> None:
    refuses("pickle that is damaged or not of numbers", load_plain, HOSTILE[kind] + b".", "file")


def test_an_address_in_a_pickled_array_is_never_followed(tmp_path: Path) -> None:
    """As ``animarl import trajectories.npy --target auto`` once crashed."""
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        stream, {"descr": "|O", "fortran_order": False, "shape": ()}
    )
    body = EMPTY + b"(I1\n(I1\nt" + HOSTILE["object field"] + b"I0\nS'AAAAAAAA'\ntb"
    path = tmp_path / "pos_val_rep_2on1.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("pos.npy", stream.getvalue() + b"(dS'pos'\n" + body + b"s.")
    refuses(r"dtype has fields, or an unusual state|not of plain", read, path, "authors-agents")


@pytest.mark.parametrize("protocol", [3, 4])  # those of np.save
@pytest.mark.parametrize("order", ["C", "F"])
def test_unpickling_gives_back_plain_arrays_of_every_kind(protocol: int, order: Any) -> None:
    base = np.arange(12).reshape(3, 4)
    kinds = ("i1", "u2", "i4", ">i8", "f2", "f4", ">f8", "bool", "S3", "U3", ">U2", object)
    for kind in kinds:
        array = np.array(base.astype(kind), order=order)
        back = load_plain(pickle.dumps(array, protocol), "file")
        np.testing.assert_array_equal(back, array)
        assert back.dtype == array.dtype
    ragged = np.array([None, [1, 2.5], "a", np.arange(3.0)], dtype=object)
    back = load_plain(pickle.dumps(ragged, protocol), "file")
    assert back[:3].tolist() == [None, [1, 2.5], "a"] and back[3].tolist() == [0.0, 1.0, 2.0]


def test_arrays_of_unusual_kinds_are_refused_before_unpickling(tmp_path: Path) -> None:
    for kind in ("V8", "i4, f8", "M8[s]", "c8"):
        stream = io.BytesIO()
        np.save(stream, np.zeros(3, kind))
        refuses("save plain numbers or text", load_npy, stream.getvalue(), tmp_path / "a.npy")


def test_unpickling_withstands_random_and_grammatical_pickles() -> None:
    """In processes of their own; ``make fuzz`` does more of them."""
    result = fuzz(400, 1, 0, ["pickle"])
    assert result.total == 400 and result.findings == []
    assert result.counts["refused"] > 200 and result.counts["different"] > 5
