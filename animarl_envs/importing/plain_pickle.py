"""Pickles of plain values: what the paper's authors and DeepLabCut's header are stored as.

A pickle names the functions that it calls. :func:`load_plain` reads plain lists, numbers, text and
arrays as ``np.save`` writes them, and nothing else: NumPy's names lead to inert stand-ins, all
others to a refusal, so that nothing of the file runs. Arrays are made once it has been read whole.
"""

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
PLAIN = (str, bytes, int, float, bool, type(None))
DEEPEST = 40  # lists within lists; no recording nests deeper


def load_plain(raw: bytes, name: str) -> Any:
    """Return the value pickled in ``raw``; refuse anything but plain values and arrays.

    Raises InputError if it is of anything else, or damaged.
    """
    try:
        return _made(_Restricted(io.BytesIO(raw)).load())
    except Exception as error:
        what = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{name}: it holds a pickle that is damaged or not of numbers and lists ({what}): "
            "it is not opened; save plain arrays instead"
        ) from None


def _need(met: bool, what: str) -> None:
    if not met:
        raise pickle.UnpicklingError(what)


class _StandIn:
    """Arguments and state of a pickled NumPy object, of which nothing is executed."""

    def __init__(self, *given: Any) -> None:
        self.given, self.state = given, None

    def __setstate__(self, state: Any) -> None:
        _need(self.state is None, "a state is set twice")
        self.state = state


class _Dtype(_StandIn):
    pass


class _Array(_StandIn):
    pass


class _Scalar(_StandIn):
    pass


KNOWN = {"ndarray": object(), "dtype": _Dtype, "_reconstruct": _Array, "scalar": _Scalar}


class _Restricted(pickle.Unpickler):
    """An unpickler that looks up nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        place = "numpy" if name in ("ndarray", "dtype") else "numpy.core.multiarray"
        known = name in KNOWN and module.replace("._core.", ".core.") == place
        _need(known, f"it names {module}.{name}")
        return KNOWN[name]


def _made(value: Any, depth: int = 0) -> Any:
    """Return a copy of the value with arrays in place of their stand-ins."""
    kind, below = type(value), depth + 1
    _need(depth <= DEEPEST, "its lists nest too deep")
    if kind in PLAIN:
        return value
    if kind is dict:
        _need({type(key) for key in value} <= {str, int, bool}, "a dictionary has an unusual key")
        return {key: _made(entry, below) for key, entry in value.items()}
    if kind in (list, tuple):
        return kind([_made(entry, below) for entry in value])
    if kind is _Scalar:
        return _numbers(value.given[1], _plain_dtype(value.given[0]), (), "C").item()
    _need(kind is _Array, f"it holds a bare {kind.__name__}")
    shape, dtype, fortran, content = value.state[-4:]
    usual = type(shape) is tuple and all(type(n) is int and n >= 0 for n in shape)
    _need(usual, "an array has an unusual shape")
    if not (plain := _plain_dtype(dtype)).hasobject:
        return _numbers(content, plain, shape, "F" if fortran else "C")
    whole = type(content) is list and len(content) == math.prod(shape)
    _need(whole, "an array holds more or fewer objects than its shape says")
    array = np.empty(len(content), dtype=object)  # NumPy lists objects in C's order always
    for place, entry in enumerate(content):
        array[place] = _made(entry, below)
    return array.reshape(shape)


def _plain_dtype(given: Any) -> Any:
    """Return the kind of an array, whose state may hold its byte order alone."""
    plain = type(given) is _Dtype and PLAIN_CODE.fullmatch(given.given[0]) is not None
    _need(plain, "an array is not of plain numbers, text or objects")
    code, state = given.given[0], given.state
    if state is None:
        return np.dtype(code)
    _need(state[2:5] == (None,) * 3, "a dtype has fields, or an unusual state")
    return np.dtype(code).newbyteorder(state[1])


def _numbers(raw: Any, dtype: np.dtype[Any], shape: tuple[int, ...], order: Any) -> Any:
    """Return a copy of the bytes as an array; refuse values that do not exist."""
    whole = type(raw) is bytes and len(raw) == math.prod(shape) * dtype.itemsize
    _need(whole and not dtype.hasobject, "numbers have more or fewer bytes than their kind")
    _need(dtype.kind != "b" or not raw.strip(b"\0\1"), "a truth value is neither true nor false")
    array = np.frombuffer(raw, dtype=dtype).reshape(shape, order=order)
    return checked_text(Path("a text"), array.copy())
