"""What stands for NumPy while a pickle of strangers is followed, and what becomes of it after.

A stand-in is a Python object without behaviour: a dtype keeps its code, an array its shape and its
bytes or list. Codes are those of plain numbers, truth values, text and objects, never of records,
subarrays or dates, whose layout a file could choose so that its bytes are taken for addresses.
"""

from __future__ import annotations

import math
import pickle
import re
from collections.abc import Iterable
from typing import Any, NoReturn

import numpy as np

from animarl_envs.files import HIGHEST_CHARACTER

PLAIN_CODE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[US]\d{1,6}|O8?)")
DEEPEST = 40  # lists within lists; no recording nests deeper
MOST_AXES = 16
WIDEST = 64  # bits of a whole number
LARGEST_KEY = 2**60  # larger whole numbers could be chosen to collide in a dictionary
_PLAIN = (str, bytes, int, float, bool, type(None))


def refuse(what: str) -> NoReturn:
    """End the reading of a pickle."""
    raise pickle.UnpicklingError(what)


class DtypeStandIn:
    """Stands for a dtype: its code and byte order."""

    __slots__ = ("code", "filled")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, code: Any, *_: Any) -> None:
        if isinstance(code, bytes):
            code = code.decode("ascii")
        if not isinstance(code, str) or not PLAIN_CODE.fullmatch(code):
            refuse("an array is not of plain numbers, text or objects")
        self.code, self.filled = code, False

    def fill(self, state: Any) -> None:
        """The state that NumPy writes; only its byte order is used, and fields are refused."""
        if self.filled or type(state) is not tuple or len(state) < 5 or state[2:5] != (None,) * 3:
            refuse("a dtype has fields, or an unusual state")
        order = state[1].decode("ascii") if isinstance(state[1], bytes) else state[1]
        if order not in ("<", ">", "|", "="):
            refuse("a dtype has an unusual byte order")
        self.filled = True
        if order in ("<", ">"):
            self.code = order + self.code.lstrip("<>|=")

    @property
    def dtype(self) -> np.dtype[Any]:
        return np.dtype(self.code)


class ArrayStandIn:
    """Stands for an array: a kind, a shape, and its bytes or the list of its objects."""

    __slots__ = ("content", "kind", "order", "shape")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self) -> None:
        self.kind: DtypeStandIn | None = None
        self.shape: tuple[int, ...] = ()
        self.order = "C"
        self.content: Any = None

    def fill(self, state: Any) -> None:
        """State as NumPy writes it: (version,) shape, dtype, whether in Fortran's order, content.

        Shape and length are compared here, before NumPy sees either.
        """
        if self.kind is not None or type(state) is not tuple or len(state) not in (4, 5):
            refuse("an array has an unusual state")
        shape, kind, fortran, content = state[-4:]
        if type(kind) is not DtypeStandIn or type(fortran) not in (bool, int):
            refuse("an array has an unusual kind")
        plain = type(shape) is tuple and all(type(n) is int and n >= 0 for n in shape)
        if not plain or len(shape) > MOST_AXES:
            refuse("an array has an unusual shape")
        count = math.prod(shape)
        if kind.dtype.hasobject:
            if type(content) is not list or len(content) != count:
                refuse("an array holds more or fewer objects than its shape says")
        else:
            if type(content) is str:
                content = content.encode("latin1")
            if type(content) is not bytes or len(content) != count * kind.dtype.itemsize:
                refuse("an array holds more or fewer bytes than its shape says")
        self.kind, self.shape, self.content = kind, shape, content
        self.order = "F" if fortran else "C"

    def array(self) -> np.ndarray[Any, Any]:
        """A new array; of objects it has to be filled."""
        if self.kind is None:
            refuse("an array is made and never filled")
        dtype = self.kind.dtype
        if dtype.hasobject:
            return np.empty(self.shape, dtype=object)
        return _numbers(self.content, dtype).reshape(self.shape, order=self.order)  # type: ignore[call-overload,no-any-return]


def _numbers(raw: bytes, dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """A copy of the bytes as an array, if each of its values exists."""
    if dtype.itemsize == 0:
        refuse("a text has no length")
    if dtype.kind == "b" and any(raw.count(bytes([value])) for value in range(2, 256)):
        refuse("a truth value is neither true nor false")
    if dtype.kind == "U":
        codes = np.frombuffer(raw, dtype=dtype.str[0] + "u4")
        if codes.size and int(codes.max()) > HIGHEST_CHARACTER:
            refuse("a text holds characters that do not exist")
    return np.frombuffer(raw, dtype=dtype).copy()


class _Ndarray:
    """Stands for ``numpy.ndarray`` as an argument; cannot be called."""

    def __new__(cls, *_: Any) -> _Ndarray:
        raise pickle.UnpicklingError("numpy.ndarray is called")


def _reconstruct(kind: Any, shape: Any, code: Any) -> ArrayStandIn:
    if kind is not _Ndarray or shape != (0,):
        refuse("an array is made in an unusual way")
    return ArrayStandIn()


def _scalar(kind: Any, raw: Any = None) -> Any:
    if isinstance(raw, str):
        raw = raw.encode("latin1")
    if type(kind) is not DtypeStandIn or type(raw) is not bytes or kind.dtype.hasobject:
        refuse("a number is made in an unusual way")
    if len(raw) != kind.dtype.itemsize:
        refuse("a number holds more or fewer bytes than its kind")
    return _numbers(raw, kind.dtype)[0].item()


def _frombuffer(content: Any, kind: Any, shape: Any, order: Any) -> ArrayStandIn:
    if order not in ("C", "F"):
        refuse("an array is made in an unusual way")
    made = ArrayStandIn()
    made.fill((shape, kind, order == "F", content))
    return made


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        refuse("bytes are made in an unusual way")
    return str(text).encode("latin1")


def _ordered(items: Any = ()) -> dict[Any, Any]:
    if type(items) is not list or not all(type(i) in (list, tuple) and len(i) == 2 for i in items):
        if items != ():
            refuse("a dictionary is made in an unusual way")
        return {}
    check_keys(key for key, _ in items)
    return dict(items)


ADMITTED: dict[tuple[str, str], Any] = {("_codecs", "encode"): _encode}
for _module in ("numpy.core", "numpy._core"):
    ADMITTED[f"{_module}.multiarray", "_reconstruct"] = _reconstruct
    ADMITTED[f"{_module}.multiarray", "scalar"] = _scalar
    ADMITTED[f"{_module}.numeric", "_frombuffer"] = _frombuffer
ADMITTED["numpy", "ndarray"] = _Ndarray
ADMITTED["numpy", "dtype"] = DtypeStandIn
ADMITTED["collections", "OrderedDict"] = _ordered


def check_keys(keys: Iterable[Any]) -> None:
    """Keys of dictionaries and sets: text, and whole numbers that cannot be made to collide."""
    for key in keys:
        if not (type(key) in (str, bool) or (type(key) is int and abs(key) < LARGEST_KEY)):
            refuse("a dictionary or set has an unusual key")


class _Budget:
    """How many numbers a value may hold, repeated ones each time they appear."""

    def __init__(self, most: int) -> None:
        self.left = most

    def spend(self, count: int) -> None:
        self.left -= count
        if self.left < 0:
            refuse("it repeats itself beyond the file's size")


def materialised(value: Any, most: int) -> Any:
    """The value with arrays in place of their stand-ins.

    A pickle can repeat one list many times over (a "billion laughs"), which only counting finds:
    more than ``most`` numbers (or eight bytes of text) are refused.
    """
    return _real(value, _Budget(most), 0)


def _real(value: Any, budget: _Budget, depth: int) -> Any:
    kind = type(value)
    if depth > DEEPEST:
        refuse("its lists nest too deep")
    if kind in _PLAIN:
        if kind is int and value.bit_length() > WIDEST:
            refuse("a number is too long")
        budget.spend(1 + (len(value) // 8 if kind in (str, bytes) else 0))
        return value
    budget.spend(1)
    below = depth + 1
    if kind is dict:
        return {key: _real(entry, budget, below) for key, entry in value.items()}
    if kind in (list, tuple):
        return kind([_real(entry, budget, below) for entry in value])
    if kind in (set, frozenset):
        budget.spend(len(value))
        return value
    if kind is not ArrayStandIn:
        refuse(f"it holds a bare {kind.__name__}")
    made = value.array()
    budget.spend(made.size * max(made.itemsize // 8, 1))
    if made.dtype.hasobject:
        flat = made.reshape(-1)  # NumPy lists objects in C's order, whatever the array's is
        for place, entry in enumerate(value.content):
            flat[place] = _real(entry, budget, below)
    return made
