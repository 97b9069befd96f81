"""Pickles of plain lists, numbers, text and arrays as ``np.save`` writes them, and nothing else.

A pickle names the functions that it calls. Here the names of NumPy lead to inert stand-ins that
keep what they are given, and all others to a refusal, so that nothing of the file runs and NumPy
sees neither its shapes nor its bytes. Arrays are made once the whole pickle has been read.
"""

from __future__ import annotations

import io
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.files import checked_text

PLAIN_CODE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[US][1-9]\d{0,5}|O8?)")
DEEPEST = 40  # lists within lists; no recording nests deeper


def load_plain(raw: bytes, name: str) -> Any:
    """Return the value pickled in ``raw``, if it is made of plain things.

    Raises
    ------
    InputError
        If it is of anything else, or damaged.
    """
    try:
        return _made(_Restricted(io.BytesIO(raw)).load(), 0)
    except Exception as error:
        what = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{name}: it holds a pickle that is damaged or not of numbers and lists ({what}): "
            "it is not opened; save plain arrays instead"
        ) from None


def _need(met: bool, what: str) -> None:
    if not met:
        raise pickle.UnpicklingError(what)


class _Dtype:
    """Stands for a dtype: its code and byte order."""

    def __init__(self, code: Any, *_: Any) -> None:
        self.code, self.order = code, ""
        plain = isinstance(code, str) and PLAIN_CODE.fullmatch(code) is not None
        _need(plain, "an array is not of plain numbers, text or objects")

    def __setstate__(self, state: Any) -> None:
        """The state that NumPy writes; only its byte order is used, and fields are refused."""
        plain = type(state) is tuple and len(state) > 4 and state[2:5] == (None,) * 3
        _need(plain and not self.order, "a dtype has fields, or an unusual state")
        self.order = state[1]
        _need(self.order in ("<", ">", "|", "="), "a dtype has an unusual byte order")

    def made(self) -> Any:
        given = self.order in ("<", ">")
        return np.dtype(self.order + self.code.lstrip("<>|=") if given else self.code)


class _Array:
    """Stands for an array: a dtype, a shape, and its bytes or the list of its objects."""

    state: tuple[Any, ...] = (None,) * 4

    def __setstate__(self, state: Any) -> None:
        """As NumPy writes it: (version,) shape, dtype, whether in Fortran's order, content."""
        usual = type(state) is tuple and len(state) in (4, 5) and self.state[0] is None
        _need(usual, "an array has an unusual state")
        self.state = state[-4:]

    def made(self, depth: int) -> Any:
        """The array, once kind, shape and length of the content agree."""
        shape, kind, fortran, content = self.state
        _need(type(kind) is _Dtype and type(shape) is tuple, "an array is made and never filled")
        usual = len(shape) <= 16 and all(type(n) is int and n >= 0 for n in shape)
        _need(usual, "an array has an unusual shape")
        dtype, count = kind.made(), math.prod(shape)
        if not dtype.hasobject:
            return _numbers(content, dtype, count).reshape(shape, order="F" if fortran else "C")
        whole = type(content) is list and len(content) == count
        _need(whole, "an array holds more or fewer objects than its shape says")
        array = np.empty(shape, dtype=object)
        flat = array.reshape(-1)  # NumPy lists objects in C's order, whatever the array's is
        for place, entry in enumerate(content):
            flat[place] = _made(entry, depth)
        return array


class _Ndarray:
    """Stands for ``numpy.ndarray`` as an argument; cannot be called."""

    def __new__(cls, *_: Any) -> _Ndarray:
        raise pickle.UnpicklingError("numpy.ndarray is called")


def _reconstruct(kind: Any, shape: Any, code: Any) -> _Array:
    _need(kind is _Ndarray, "an array is made in an unusual way")
    return _Array()


def _scalar(kind: Any, raw: Any = b"") -> Any:
    _need(type(kind) is _Dtype and "O" not in kind.code, "a number is made in an unusual way")
    return _numbers(raw, kind.made(), 1)[0].item()


STAND_INS: dict[tuple[str, str], Any] = {
    ("numpy", "ndarray"): _Ndarray, ("numpy", "dtype"): _Dtype,
    ("numpy.core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy._core.multiarray", "_reconstruct"): _reconstruct,
    ("numpy.core.multiarray", "scalar"): _scalar, ("numpy._core.multiarray", "scalar"): _scalar,
}  # fmt: skip


class _Restricted(pickle.Unpickler):
    """Looks up nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        _need((module, name) in STAND_INS, f"it names {module}.{name}")
        return STAND_INS[module, name]


def _numbers(raw: Any, dtype: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
    """A copy of the bytes as an array, if each of its values exists."""
    whole = type(raw) is bytes and len(raw) == count * dtype.itemsize
    _need(whole, "numbers have more or fewer bytes than their kind")
    _need(dtype.kind != "b" or not raw.strip(b"\0\1"), "a truth value is neither true nor false")
    return checked_text(Path("a text"), np.frombuffer(raw, dtype=dtype).copy())


def _made(value: Any, depth: int) -> Any:
    """The value with arrays in place of their stand-ins, all of it copied."""
    kind, below = type(value), depth + 1
    _need(depth <= DEEPEST, "its lists nest too deep")
    if kind in (str, bytes, int, float, bool, type(None)):
        return value
    if kind is dict:
        _need({type(key) for key in value} <= {str, int, bool}, "a dictionary has an unusual key")
        return {key: _made(entry, below) for key, entry in value.items()}
    if kind in (list, tuple):
        return kind([_made(entry, below) for entry in value])
    _need(kind is _Array, f"it holds a bare {kind.__name__}")
    return value.made(below)
