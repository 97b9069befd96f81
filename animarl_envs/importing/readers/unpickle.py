"""Object arrays through a restricted unpickler: plain containers, numbers, arrays, nothing else.

The pure Python unpickler is used, since its memo is a dictionary (a few hostile bytes make the C
one allocate gigabytes). Classes are not looked up: NumPy's constructors are replaced by checked
ones, every other name is refused. Opcodes that allocate by their argument are removed.
"""

from __future__ import annotations

import io
import pickle
import struct
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.importing.readers.guards import allowed_bytes, npy_header

LARGEST_SHAPE = 0  # reconstructed arrays start empty; their state brings shape and bytes


_PurePython: Any = vars(pickle)["_Unpickler"]


class _Array:
    """Stands for ``numpy.ndarray`` as an argument; cannot be called."""

    def __new__(cls, *_: Any) -> _Array:
        raise pickle.UnpicklingError("numpy.ndarray is called")


def _reconstruct(kind: Any, shape: Any, code: Any) -> Any:
    if kind is not _Array or tuple(shape) != (LARGEST_SHAPE,):
        raise pickle.UnpicklingError("an array is made in an unusual way")
    return np.ndarray((0,), dtype=np.dtype("b"))


def _dtype(name: Any, *_: Any) -> np.dtype[Any]:
    if not isinstance(name, (str, bytes)):
        raise pickle.UnpicklingError("a dtype is made in an unusual way")
    return np.dtype(name if isinstance(name, str) else name.decode("ascii"))


def _scalar(dtype: Any, raw: Any = None) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or not isinstance(raw, (bytes, str)):
        raise pickle.UnpicklingError("a number is made in an unusual way")
    data = raw.encode("latin1") if isinstance(raw, str) else raw
    return np.frombuffer(data, dtype=dtype, count=1)[0]


def _frombuffer(buffer: Any, dtype: Any, shape: Any, order: Any) -> Any:
    if not isinstance(dtype, np.dtype) or dtype.hasobject or not isinstance(buffer, bytes):
        raise pickle.UnpicklingError("an array is made in an unusual way")
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


def _encode(text: Any, encoding: Any) -> bytes:
    if not isinstance(text, str) or encoding != "latin1":
        raise pickle.UnpicklingError("bytes are made in an unusual way")
    return text.encode("latin1")


_ADMITTED: dict[tuple[str, str], Any] = {("_codecs", "encode"): _encode}
for _module in ("numpy.core", "numpy._core"):
    _ADMITTED[f"{_module}.multiarray", "_reconstruct"] = _reconstruct
    _ADMITTED[f"{_module}.multiarray", "scalar"] = _scalar
    _ADMITTED[f"{_module}.numeric", "_frombuffer"] = _frombuffer
_ADMITTED["numpy", "ndarray"] = _Array
_ADMITTED["numpy", "dtype"] = _dtype
_ADMITTED["collections", "OrderedDict"] = dict

_REFUSED = (
    pickle.NEXT_BUFFER, pickle.READONLY_BUFFER, pickle.PERSID, pickle.BINPERSID,
    pickle.EXT1, pickle.EXT2, pickle.EXT4, pickle.INST, pickle.OBJ, pickle.NEWOBJ, pickle.NEWOBJ_EX,
)  # fmt: skip


class _Restricted(_PurePython):  # type: ignore[misc]
    """Looks up nothing but the admitted constructors."""

    dispatch: dict[int, Any] = {
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

    dispatch[pickle.BYTEARRAY8[0]] = load_byte_array

    def find_class(self, module: str, name: str) -> Any:
        try:
            return _ADMITTED[module, name]
        except KeyError:
            raise pickle.UnpicklingError(f"it names {module}.{name}") from None


def load_plain(raw: bytes, name: str) -> Any:
    """The value pickled in ``raw``, if it is made of plain containers, numbers and arrays."""
    try:
        return _Restricted(io.BytesIO(raw)).load()
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
        shape, dtype = npy_header(path, stream)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{place}: it is no npy array ({error}): copy it again") from None
    if not dtype.hasobject:
        start = stream.tell()
        stream.seek(0)
        size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
        held = len(raw) - start
        if size != held:
            raise InputError(
                f"{place}: its header announces {size:,} bytes and it holds {held:,}: copy it again"
            )
        return np.load(stream, allow_pickle=False)
    value = load_plain(raw[stream.tell() :], place)
    if isinstance(value, np.ndarray) and value.shape != tuple(shape):
        raise InputError(f"{place}: its header and content differ in shape: copy it again")
    return value


def count_leaves(value: Any, path: Path) -> int:
    """Numbers in nested lists and object arrays; refuses more than the file can hold.

    A pickle can repeat one list many times over (a "billion laughs"), which only counting finds.
    """
    budget = allowed_bytes(path) // 8
    stack, leaves = [value], 0
    while stack:
        top = stack.pop()
        if isinstance(top, dict):
            stack.extend(top.values())
        elif isinstance(top, (list, tuple)):
            stack.extend(top)
        elif isinstance(top, np.ndarray) and top.dtype.hasobject:
            stack.extend(top.ravel().tolist())
        else:
            leaves += top.size if isinstance(top, np.ndarray) else 1
        if leaves + len(stack) > budget:
            raise InputError(f"{path}: its pickle repeats itself beyond the file's size: refused")
    return leaves
