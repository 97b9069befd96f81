"""Pickles of plain containers, numbers, text and arrays; anything else in them is refused.

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
from typing import Any, NoReturn

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.files import HIGHEST_CHARACTER, check_size, checked_text, npy_header

PLAIN_CODE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[US]\d{1,6}|O8?)")
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


def load_npy(raw: bytes, path: Path, member: str = "", objects: bool = False) -> Any:
    """Return the content of an ``.npy`` stream, of object arrays only if ``objects`` is true."""
    stream = io.BytesIO(raw)
    place = f"{path}: {member}" if member else str(path)
    try:
        shape, dtype, size = npy_header(path, stream)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{place}: it is no npy array ({error}): copy it again") from None
    if dtype.hasobject:
        if not objects:
            raise InputError(
                f"{place}: it holds a pickle of Python objects, which is never opened: check "
                "--source, or save numbers"
            )
        value = load_plain(raw[stream.tell() :], place)
        if isinstance(value, np.ndarray) and value.shape != shape:
            raise InputError(f"{place}: its header and content differ in shape: copy it again")
        return value
    held = len(raw) - stream.tell()
    if size != held:
        raise InputError(
            f"{place}: its header announces {size:,} bytes and it holds {held:,}: copy it again"
        )
    check_size(path, size // max(dtype.itemsize, 1) * 8, member or "its array")
    stream.seek(0)
    return checked_text(path, np.load(stream, allow_pickle=False))


class _Dtype:
    """Stands for a dtype: its code and byte order."""

    __slots__ = ("code", "filled")

    def __init__(self, code: Any, *_: Any) -> None:
        code = code.decode("ascii") if isinstance(code, bytes) else code
        if not isinstance(code, str) or not PLAIN_CODE.fullmatch(code):
            _refuse("an array is not of plain numbers, text or objects")
        self.code, self.filled = code, False

    def __setstate__(self, state: Any) -> None:
        """The state that NumPy writes; only its byte order is used, and fields are refused."""
        if self.filled or type(state) is not tuple or len(state) < 5 or state[2:5] != (None,) * 3:
            _refuse("a dtype has fields, or an unusual state")
        order = state[1].decode("ascii") if isinstance(state[1], bytes) else state[1]
        if order not in ("<", ">", "|", "="):
            _refuse("a dtype has an unusual byte order")
        self.filled = True
        if order in ("<", ">"):
            self.code = order + self.code.lstrip("<>|=")


class _Array:
    """Stands for an array: a dtype, a shape, and its bytes or the list of its objects."""

    __slots__ = ("state",)

    def __setstate__(self, state: Any) -> None:
        """As NumPy writes it: (version,) shape, dtype, whether in Fortran's order, content."""
        if hasattr(self, "state") or type(state) is not tuple or len(state) not in (4, 5):
            _refuse("an array has an unusual state")
        self.state = state[-4:]

    def made(self, depth: int) -> np.ndarray[Any, Any]:
        """The array, once kind, shape and length of the content agree."""
        shape, kind, fortran, content = getattr(self, "state", (None,) * 4)
        if type(kind) is not _Dtype or type(shape) is not tuple:
            _refuse("an array is made and never filled")
        if len(shape) > 16 or not all(type(n) is int and n >= 0 for n in shape):
            _refuse("an array has an unusual shape")
        if type(content) is str:
            content = content.encode("latin1")
        content = bytes(content) if type(content) is bytearray else content
        dtype, count = np.dtype(kind.code), math.prod(shape)
        if dtype.hasobject:
            if type(content) is not list or len(content) != count:
                _refuse("an array holds more or fewer objects than its shape says")
            array = np.empty(shape, dtype=object)
            flat = array.reshape(-1)  # NumPy lists objects in C's order, whatever the array's is
            for place, entry in enumerate(content):
                flat[place] = _made(entry, depth)
            return array
        if type(content) is not bytes or len(content) != count * dtype.itemsize:
            _refuse("an array holds more or fewer bytes than its shape says")
        return _numbers(content, dtype).reshape(shape, order="F" if fortran else "C")


class _Ndarray:
    """Stands for ``numpy.ndarray`` as an argument; cannot be called."""

    def __new__(cls, *_: Any) -> _Ndarray:
        raise pickle.UnpicklingError("numpy.ndarray is called")


def _reconstruct(kind: Any, shape: Any, code: Any) -> _Array:
    if kind is not _Ndarray:
        _refuse("an array is made in an unusual way")
    return _Array()


def _frombuffer(content: Any, kind: Any, shape: Any, order: Any) -> _Array:
    made = _Array()
    made.__setstate__((shape, kind, order == "F", content))
    return made


def _scalar(kind: Any, raw: Any = b"") -> Any:
    raw = raw.encode("latin1") if isinstance(raw, str) else raw
    if type(kind) is not _Dtype or type(raw) is not bytes or "O" in kind.code:
        _refuse("a number is made in an unusual way")
    dtype = np.dtype(kind.code)
    if len(raw) != dtype.itemsize:
        _refuse("a number holds more or fewer bytes than its kind")
    return _numbers(raw, dtype)[0].item()


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        _refuse("bytes are made in an unusual way")
    return str(text).encode("latin1")


STAND_INS: dict[tuple[str, str], Any] = {
    ("_codecs", "encode"): _encode, ("numpy", "ndarray"): _Ndarray, ("numpy", "dtype"): _Dtype,
}  # fmt: skip
for _module in ("numpy.core", "numpy._core"):
    STAND_INS[f"{_module}.multiarray", "_reconstruct"] = _reconstruct
    STAND_INS[f"{_module}.multiarray", "scalar"] = _scalar
    STAND_INS[f"{_module}.numeric", "_frombuffer"] = _frombuffer


class _Restricted(pickle.Unpickler):
    """Looks up nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        try:
            return STAND_INS[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"it names {module}.{name}") from None


def _numbers(raw: bytes, dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """A copy of the bytes as an array, if each of its values exists."""
    if dtype.itemsize == 0:
        _refuse("a text has no length")
    if dtype.kind == "b" and any(raw.count(bytes([value])) for value in range(2, 256)):
        _refuse("a truth value is neither true nor false")
    if dtype.kind == "U":
        codes = np.frombuffer(raw, dtype=dtype.str[0] + "u4")
        if codes.size and int(codes.max()) > HIGHEST_CHARACTER:
            _refuse("a text holds characters that do not exist")
    return np.frombuffer(raw, dtype=dtype).copy()


def _made(value: Any, depth: int) -> Any:
    """The value with arrays in place of their stand-ins, all of it copied."""
    kind, below = type(value), depth + 1
    if depth > DEEPEST:
        _refuse("its lists nest too deep")
    if kind in (str, bytes, int, float, bool, type(None)):
        return value
    if kind is dict:
        return {_key(key): _made(entry, below) for key, entry in value.items()}
    if kind in (list, tuple):
        return kind([_made(entry, below) for entry in value])
    if kind in (set, frozenset):
        return kind(map(_key, value))
    if kind is not _Array:
        _refuse(f"it holds a bare {kind.__name__}")
    return value.made(below)


def _key(key: Any) -> Any:
    if type(key) not in (str, int, bool):
        _refuse("a dictionary or set has an unusual key")
    return key


def _refuse(what: str) -> NoReturn:
    raise pickle.UnpicklingError(what)
