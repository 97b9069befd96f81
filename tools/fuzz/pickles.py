"""Pickles: bytes at random, opcodes by their grammar, and damaged ones of real arrays."""

from __future__ import annotations

import pickle
import pickletools
from typing import Any

import numpy as np

NAMES = (
    ("numpy", "ndarray"), ("numpy", "dtype"), ("numpy.core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"), ("numpy._core.numeric", "_frombuffer"),
    ("_codecs", "encode"), ("collections", "OrderedDict"), ("os", "system"), ("builtins", "eval"),
)  # fmt: skip
WORDS = (b"V8", b"O8", b"f8", b"U2", b"b1", b"<", b"|", b"i4, O", b"M8[s]", b"", b"\xff" * 8, b"a")
REAL: tuple[Any, ...] = (
    np.arange(6.0).reshape(3, 2), np.array([1, None, "a"], dtype=object), np.array(["ab", "c"]),
    {"a": [1, (2.5, "x")], "b": np.float64(2.0)}, np.zeros((2, 2), order="F", dtype=">i4"),
)  # fmt: skip
SHAPED = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(K\x00tC\x01btR"


def random_pickle(rng: np.random.Generator) -> bytes:
    """Any of the three."""
    how = int(rng.integers(3))
    if how == 0:
        return b"\x80" + bytes([int(rng.integers(6))]) + rng.bytes(int(rng.integers(1, 200))) + b"."
    if how == 1:
        return grammatical(rng)
    value = REAL[int(rng.integers(len(REAL)))]
    data = bytearray(pickle.dumps(value, protocol=int(rng.integers(6))))
    for at in rng.integers(len(data), size=int(rng.integers(1, 5))).tolist():
        data[at] = int(rng.integers(256))
    return bytes(data)


def grammatical(rng: np.random.Generator) -> bytes:
    """Opcodes with arguments of their kind, most of which build or call; ends by STOP."""
    favoured = [op for op in pickletools.opcodes if op.name in FAVOURED]
    out = [b"\x80\x04"]
    if rng.random() < 0.3:
        out.append(SHAPED)
    for _ in range(int(rng.integers(1, 40))):
        pool = favoured if rng.random() < 0.7 else pickletools.opcodes
        op = pool[int(rng.integers(len(pool)))]
        out.append(op.code.encode("latin1") + _argument(op, rng))
    return b"".join(out) + b"."


FAVOURED = {
    "MARK", "GLOBAL", "REDUCE", "BUILD", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_TUPLE",
    "EMPTY_LIST", "EMPTY_DICT", "APPENDS", "SETITEMS", "BINBYTES", "SHORT_BINBYTES", "BININT1",
    "BINUNICODE", "NONE", "NEWFALSE", "DUP", "MEMOIZE", "BINGET", "SHORT_BINUNICODE", "BININT",
}  # fmt: skip


def _argument(op: Any, rng: np.random.Generator) -> bytes:
    if op.name in ("GLOBAL", "INST"):
        module, name = NAMES[int(rng.integers(len(NAMES)))]
        return f"{module}\n{name}\n".encode()
    if op.arg is None:
        return b""
    word = WORDS[int(rng.integers(len(WORDS)))]
    small = int(rng.integers(5))
    if op.arg.n > 0:
        return small.to_bytes(op.arg.n, "little")
    lengths = {-2: 1, -3: 4, -4: 4, -5: 8}  # as pickletools marks counts before the content
    if op.arg.n in lengths:
        return len(word).to_bytes(lengths[op.arg.n], "little") + word
    return str(small).encode() + b"\n"
