"""Plain arrays: NumPy (``.npy``, ``.npz``), MATLAB (``.mat``, version 5 to 7.3), and HDF5.

HDF5 can point out of the file (links, external storage, virtual datasets), ask for filters that are
loaded from the disk, and describe numbers of any layout. None of it is in a file of tracks, so none
of it is followed: such a file is refused as a whole.

A pickle names the functions that it calls. :func:`load_plain` reads plain lists, numbers, text and
arrays as ``np.save`` writes them, and nothing else: NumPy's names lead to inert stand-ins, all
others to a refusal, so that nothing of the file runs. Arrays are made once it has been read whole.
"""

import contextlib
import io
import math
import pickle
import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import refusing_damage
from animarl_envs.errors import InputError, MissingExtraError, require_extra
from animarl_envs.files import checked_text, load_npy, npz_members, read_npz
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import CENTROID, Tracks

AXES = ("frame", "individual", "keypoint", "xy")
DEFAULT_AXES = {2: ("frame", "xy"), 3: ("frame", "individual", "xy"), 4: AXES}


@register_track_reader(
    "matlab",
    "MATLAB arrays (.mat, all versions); option axes as for numpy",
    sniff=lambda path: path.suffix.lower() == ".mat",
    extensions=(".mat",),
    generic=True,
)
@register_track_reader(
    "numpy",
    "NumPy arrays (.npy, .npz); option axes, such as [frame, individual, xy]",
    sniff=lambda path: path.suffix.lower() == ".npy" or len(npz_members(path)) == 1,
    extensions=(".npy", ".npz"),
    generic=True,
)
def read_arrays(
    path: Path,
    key: str | None = None,
    axes: Sequence[str] | None = None,
    names: Sequence[str] | None = None,
    keypoints: Sequence[str] | None = None,
    fps: float | None = None,
    unit: str = "px",
    y_down: bool = False,
) -> list[Tracks]:
    """One recording, or every array of a file as one where ``key`` is ``"*"``.

    Axes are as NumPy and MATLAB show them (MATLAB 7.3 stores them reversed, which is undone).
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        arrays = read_npz(path)
    elif suffix == ".mat":
        arrays = _matlab_arrays(path)
    else:
        arrays = {path.stem: load_npy(path.read_bytes(), path)}
    numeric = {name: a for name, a in arrays.items() if a.dtype.kind in "iuf" and a.ndim >= 2}
    chosen = {} if key == "*" or key not in arrays else {key: arrays[key]}
    if key == "*" or (key is None and len(numeric) == 1):
        chosen = numeric
    if not chosen:
        known = [name for name, value in arrays.items() if value.dtype.kind in "iuf"]
        raise InputError(
            f"{path}: it holds {', '.join(known) or 'no array of numbers'}: name the one with the "
            "positions by the option key, or * for all"
        )
    found = []
    for name, array in chosen.items():
        positions = _ordered(path, name, array, axes)
        individuals = _names(path, "individual", names, positions.shape[1])
        parts = _names(path, "keypoint", keypoints, positions.shape[2])
        if keypoints is None and positions.shape[2] == 1:
            parts = (CENTROID,)
        found.append(
            Tracks(
                recording=path.stem if len(chosen) == 1 else name, individuals=individuals,
                keypoints=parts, positions=positions, frame_rate=fps, unit=unit, y_down=y_down,
                provenance={"file": path.name},
            )
        )  # fmt: skip
    return found


def _matlab_arrays(path: Path) -> dict[str, NDArray[Any]]:
    if is_hdf(path):
        with open_hdf(path) as file:
            names = [n for n in file if not n.startswith("#") and hasattr(file[n], "shape")]
            return {name: read_dataset(path, file, name).T for name in names}
    from scipy.io import loadmat

    return {name: value for name, value in loadmat(path).items() if hasattr(value, "dtype")}


def _ordered(
    path: Path, name: str, array: NDArray[Any], axes: Sequence[str] | None
) -> NDArray[np.float64]:
    """Axes (frame, individual, keypoint, xy)."""
    if array.dtype.kind not in "iuf":
        raise InputError(f"{path}: {name} is {array.dtype}, not numbers: choose another key")
    given = tuple(axes) if axes is not None else DEFAULT_AXES.get(array.ndim, ())
    fits = len(given) == array.ndim and len(set(given)) == len(given)
    if not fits or not {"frame", "xy"} <= set(given) <= set(AXES):
        raise InputError(
            f"{path}: {name} has shape {array.shape}, which the axes {', '.join(given) or '?'} do "
            f"not fit: give the option axes, an order of {', '.join(AXES)}"
        )
    if array.shape[given.index("xy")] != 2:
        raise InputError(
            f"{path}: {name} has {array.shape[given.index('xy')]} entries along xy (shape "
            f"{array.shape}): give the option axes in the order of the array"
        )
    present = [axis for axis in AXES if axis in given]
    positions = np.asarray(array, dtype=np.float64).transpose([given.index(a) for a in present])
    return np.expand_dims(positions, tuple(i for i, axis in enumerate(AXES) if axis not in given))


def _names(path: Path, what: str, names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{what}_{i}" for i in range(count))
    if len(names) != count:
        raise InputError(f"{path}: {len(names)} names for {count} {what}s: give one for each")
    return tuple(names)


MAGIC = b"\x89HDF\r\n\x1a\n"
HEAD = 96  # the longest header of a file [bytes]
END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # where it says the file's length, by its version
MATLAB_OFFSET = 512  # MATLAB writes a header of its own before the HDF5 one
FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, checksum, lzf: those that h5py brings along


def is_hdf(path: Path) -> bool:
    """Whether the file starts like HDF5 (or MATLAB 7.3)."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        start = file.read(MATLAB_OFFSET + len(MAGIC))
        return start.startswith(MAGIC) or start[MATLAB_OFFSET:] == MAGIC
    return False


def open_hdf(path: Path) -> Any:
    """Return an open ``h5py.File`` that points nowhere and holds usual numbers.

    Raises InputError if it is none or holds anything unusual; damaged, whatever h5py raises.
    """
    with require_extra("reading HDF5", "data"):
        import h5py
    if not is_hdf(path):
        raise InputError(f"{path}: it is no HDF5 file: check --source, or copy the file again")
    _check_end(path)
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(h5py.File(path, "r"))
        _check_contents(path, file)
        stack.pop_all()
    return file


def hdf_keys(path: Path) -> set[str]:
    """Return the names at the top of an HDF5 file; none if it is none, or damaged."""
    with contextlib.suppress(InputError, MissingExtraError), refusing_damage(path):
        if is_hdf(path):
            with open_hdf(path) as file:
                return set(file.keys())
    return set()


def read_dataset(path: Path, file: Any, key: str) -> NDArray[Any]:
    """Return one dataset of a file from :func:`open_hdf`."""
    if key not in file:
        raise InputError(f"{path}: it has no dataset {key!r}: check --source")
    if not hasattr(file[key], "shape"):
        raise InputError(f"{path}: {key!r} is a group, not an array: name an array")
    return np.asarray(file[key][()])


def _check_end(path: Path) -> None:
    """Refuse a file that goes on beyond the end its header names (a shorter one fails to open)."""
    with path.open("rb") as file:
        head = file.read(MATLAB_OFFSET + HEAD)
    start = 0 if head.startswith(MAGIC) else MATLAB_OFFSET
    version, widths = head[start + 8], head[start + 13 : start + 15]
    if version in END_AT and (version > 1 or widths[:1] == b"\x08"):
        (end,) = struct.unpack_from("<Q", head.ljust(MATLAB_OFFSET + HEAD), start + END_AT[version])
        if path.stat().st_size > end:
            raise InputError(
                f"{path}: the HDF5 file is longer ({path.stat().st_size:,} bytes) than its header "
                f"says ({end:,}): copy it again"
            )


def _check_contents(path: Path, file: Any) -> None:
    """Refuse a file that points outside, or holds numbers or filters of no usual kind."""
    import h5py

    waiting, seen = [file["/"]], set()
    while waiting:
        thing = waiting.pop()
        address = h5py.h5o.get_info(thing.id).addr
        if address in seen:
            continue
        seen.add(address)
        place, found = thing.name, []
        kinds = [thing.attrs.get_id(name).get_type() for name in thing.attrs]
        if isinstance(thing, h5py.Dataset):
            settings = thing.id.get_create_plist()
            kinds.append(thing.id.get_type())
            packed = {settings.get_filter(i)[0] for i in range(settings.get_nfilters())}
            found = [
                "a virtual dataset, made of other files" * thing.is_virtual,
                "stored in another file" * bool(thing.external),
                "packed by an unusual filter" * bool(packed - FILTERS),
            ]
        elif isinstance(thing, h5py.Group):
            for name in thing:
                if isinstance(thing.get(name, getlink=True), h5py.HardLink):
                    waiting.append(thing[name])
                else:
                    place, found = f"{place.rstrip('/')}/{name}", ["a link to elsewhere"]
                    break
        if what := next(filter(None, [*found, *map(_unusual, kinds)]), ""):
            raise InputError(
                f"{path}: {place} is {what}: it is not followed, export plain arrays instead"
            )


def _unusual(kind: Any) -> str:
    """Say how bits of numbers are laid out in an unusual way, which would be read as others."""
    from h5py import h5t

    if isinstance(kind, h5t.TypeFloatID):
        usual = [
            getattr(h5t, f"IEEE_F{bits}{order}") for bits in (16, 32, 64) for order in ("LE", "BE")
        ]
        return "" if any(map(kind.equal, usual)) else "of floats that are not IEEE's"
    if isinstance(kind, h5t.TypeIntegerID):
        whole = kind.get_precision() == 8 * kind.get_size() and kind.get_offset() == 0
        return "" if whole else "of whole numbers with unused bits"
    if isinstance(kind, h5t.TypeCompoundID):
        members = (_unusual(kind.get_member_type(i)) for i in range(kind.get_nmembers()))
        return next(filter(None, members), "")
    if isinstance(kind, (h5t.TypeArrayID, h5t.TypeEnumID, h5t.TypeVlenID)):
        return _unusual(kind.get_super())
    return ""


# -- pickles ---------------------------------------------------------------------------------------

PLAIN_CODE = re.compile(r"[<>|=]?(b1|\?|i[1248]|u[1248]|f[248]|[US][1-9]\d{0,5}|O8?)")
PLAIN = (str, bytes, int, float, bool, type(None))
DEEPEST = 40  # lists within lists; no recording nests deeper


def load_plain(raw: bytes, name: str) -> Any:
    """Return the value pickled in ``raw``, if it is made of plain things.

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
    """Keeps what an object of NumPy's was called with, and its state; nothing else is done."""

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
    """Looks up nothing but the stand-ins."""

    def find_class(self, module: str, name: str) -> Any:
        place = "numpy" if name in ("ndarray", "dtype") else "numpy.core.multiarray"
        known = name in KNOWN and module.replace("._core.", ".core.") == place
        _need(known, f"it names {module}.{name}")
        return KNOWN[name]


def _made(value: Any, depth: int = 0) -> Any:
    """The value with arrays in place of their stand-ins, all of it copied."""
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
    """The kind of an array, whose state may say its byte order and nothing else."""
    plain = type(given) is _Dtype and PLAIN_CODE.fullmatch(given.given[0]) is not None
    _need(plain, "an array is not of plain numbers, text or objects")
    code, state = given.given[0], given.state
    if state is None:
        return np.dtype(code)
    _need(state[2:5] == (None,) * 3, "a dtype has fields, or an unusual state")
    return np.dtype(code).newbyteorder(state[1])


def _numbers(raw: Any, dtype: np.dtype[Any], shape: tuple[int, ...], order: Any) -> Any:
    """A copy of the bytes as an array, if each of its values exists."""
    whole = type(raw) is bytes and len(raw) == math.prod(shape) * dtype.itemsize
    _need(whole and not dtype.hasobject, "numbers have more or fewer bytes than their kind")
    _need(dtype.kind != "b" or not raw.strip(b"\0\1"), "a truth value is neither true nor false")
    array = np.frombuffer(raw, dtype=dtype).reshape(shape, order=order)
    return checked_text(Path("a text"), array.copy())
