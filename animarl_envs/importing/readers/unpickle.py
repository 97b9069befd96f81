"""Object arrays through a restricted unpickler: plain containers, numbers, text, arrays, no more.

While a pickle is followed nothing of NumPy exists: its constructors are replaced by inert
stand-ins, which keep what they are given. Only when the whole pickle has been read are arrays made
of them, once kind, shape and length of the bytes agree. BUILD, with which a pickle sets the state
of an object, works on the stand-ins alone.

The pure Python unpickler is used, since its memo is a dictionary (a few hostile bytes make the C
one allocate gigabytes). Opcodes that allocate by their argument are removed.
"""

from __future__ import annotations

import io
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.files import check_size, checked_text, npy_header
from animarl_envs.importing.readers.stand_ins import (
    ADMITTED,
    ArrayStandIn,
    DtypeStandIn,
    check_keys,
    materialised,
)

_PurePython: Any = vars(pickle)["_Unpickler"]
LARGEST_MEMO = 2**32  # beyond it, numbers could be chosen to collide as keys
REPEATS, ALLOWED_REPEATS = 8, 10_000  # numbers per byte of a pickle, and without any

_REFUSED = (
    pickle.NEXT_BUFFER, pickle.READONLY_BUFFER, pickle.PERSID, pickle.BINPERSID,
    pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.INST, pickle.OBJ, pickle.NEWOBJ, pickle.NEWOBJ_EX,
)  # fmt: skip


class _Restricted(_PurePython):  # type: ignore[misc]
    """Looks up nothing but the admitted stand-ins, calls and fills nothing else."""

    dispatch: dict[int, Callable[[Any], None]] = {
        code: handler
        for code, handler in _PurePython.dispatch.items()
        if code not in {refused[0] for refused in _REFUSED}
    }

    def load_byte_array(self) -> None:
        """Like the original, but reads before it allocates (and makes bytes)."""
        (length,) = struct.unpack("<Q", self.read(8))
        data = self.read(length)
        if len(data) != length:
            raise pickle.UnpicklingError("it is cut short")
        self.append(data)

    def load_reduce(self) -> None:
        """Calls an admitted stand-in."""
        arguments = self.stack.pop()
        function = self.stack[-1]
        if type(arguments) is not tuple or not any(function is one for one in ADMITTED.values()):
            raise pickle.UnpicklingError("it calls what is not to be called")
        self.stack[-1] = function(*arguments)

    def load_build(self) -> None:
        """Fills a stand-in, once."""
        state = self.stack.pop()
        if type(self.stack[-1]) not in (ArrayStandIn, DtypeStandIn):
            raise pickle.UnpicklingError("it sets the state of what has none")
        self.stack[-1].fill(state)

    def load_dict(self) -> None:
        items = self.pop_mark()
        check_keys(items[::2])
        self.append({items[i]: items[i + 1] for i in range(0, len(items), 2)})

    def load_setitem(self) -> None:
        value, key = self.stack.pop(), self.stack.pop()
        self._set([key, value])

    def load_setitems(self) -> None:
        self._set(self.pop_mark())

    def _set(self, items: list[Any]) -> None:
        check_keys(items[::2])
        if type(self.stack[-1]) is not dict:
            raise pickle.UnpicklingError("it puts keys into what is no dictionary")
        for i in range(0, len(items), 2):
            self.stack[-1][items[i]] = items[i + 1]

    def load_append(self) -> None:
        self._extend([self.stack.pop()])

    def load_appends(self) -> None:
        self._extend(self.pop_mark())

    def _extend(self, items: list[Any]) -> None:
        if type(self.stack[-1]) is not list:
            raise pickle.UnpicklingError("it appends to what is no list")
        self.stack[-1].extend(items)

    def load_additems(self) -> None:
        items = self.pop_mark()
        check_keys(items)
        if type(self.stack[-1]) is not set:
            raise pickle.UnpicklingError("it adds to what is no set")
        self.stack[-1].update(items)

    def load_frozenset(self) -> None:
        items = self.pop_mark()
        check_keys(items)
        self.append(frozenset(items))

    def load_put(self) -> None:
        number = int(self.readline()[:-1])
        if not 0 <= number < LARGEST_MEMO:
            raise pickle.UnpicklingError("its memo is numbered unusually")
        self.memo[number] = self.stack[-1]

    for _code, _handler in (
        (pickle.BYTEARRAY8, load_byte_array), (pickle.REDUCE, load_reduce),
        (pickle.BUILD, load_build), (pickle.DICT, load_dict), (pickle.SETITEM, load_setitem),
        (pickle.SETITEMS, load_setitems), (pickle.APPEND, load_append),
        (pickle.APPENDS, load_appends), (pickle.ADDITEMS, load_additems),
        (pickle.FROZENSET, load_frozenset), (pickle.PUT, load_put),
    ):  # fmt: skip
        dispatch[_code[0]] = _handler

    def find_class(self, module: str, name: str) -> Any:
        try:
            return ADMITTED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"it names {module}.{name}") from None


def load_plain(raw: bytes, name: str) -> Any:
    """The value pickled in ``raw``, if it is made of plain containers, numbers, text and arrays.

    Raises
    ------
    InputError
        If it is of anything else, is damaged, or repeats itself beyond its own size.
    """
    try:
        value = _Restricted(io.BytesIO(raw)).load()
        return materialised(value, REPEATS * len(raw) + ALLOWED_REPEATS)
    except Exception as error:
        what = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise InputError(
            f"{name}: it holds a pickle that is damaged or not of numbers and lists ({what}): "
            "it is not opened; save plain arrays instead"
        ) from None


def load_object_npy(raw: bytes, path: Path, member: str = "") -> Any:
    """Content of an ``.npy`` stream, object arrays included."""
    stream = io.BytesIO(raw)
    place = f"{path}: {member}" if member else str(path)
    try:
        shape, dtype, size = npy_header(path, stream)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{place}: it is no npy array ({error}): copy it again") from None
    if dtype.hasobject:
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
