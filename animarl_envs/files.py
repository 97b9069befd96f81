"""Files: written whole or not at all; read without pickle and within the memory that they may ask.

The rule: a file may ask for at most ``EXPANSION`` times its own size up to ``FREELY``, beyond that
for ``LARGE_EXPANSION`` times, and for ``ALLOWANCE`` in any case. A header that asks for more is
refused before anything is allocated. Numbers count as float64, which all of them become.

YAML is read as plain data: no tags that name code, no text that becomes larger than it is.
"""

import errno
import glob
import io
import json
import math
import os
import secrets
import shutil
import stat
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require, require_extra

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

EXPANSION = 64
FREELY = 256 * 2**20  # [bytes]
LARGE_EXPANSION = 16
ALLOWANCE = 16 * 2**20  # [bytes]
MOST_MEMBERS = 10_000  # of an archive
LONGEST_RECORD = 16 * 2**20  # [bytes] of a JSON file in a run's folder
PART = ".part"
RANDOM = 8  # characters that tempfile draws
JUST_MADE = 1.0  # [s] within which a temporary file may not be locked yet
Unpickle = Callable[[bytes, str], Any]
PLAIN_KINDS = "biufSU"  # truth values, whole numbers, floats, bytes, text
PACKINGS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}  # others allocate what a header says


def is_part(path: Path) -> bool:
    """Return whether a file is a temporary one of :func:`write_then_rename`."""
    return path.name.startswith(".") and PART in path.suffixes


@contextmanager
def write_then_rename(path: str | Path) -> Iterator[Path]:
    """Hand out a temporary path beside ``path``; rename it to ``path`` if the block succeeds.

    An error or Ctrl-C inside the block removes the temporary file and leaves ``path`` as it was.
    After a kill it stays until the same path is written again. The temporary name ends like
    ``path``, for libraries that look at the suffix. Links are followed. Raises InputError if the
    file cannot be written: a full disk, a folder that is not writable, a pipe or a device.
    """
    path = Path(path)
    if path.is_symlink():
        path = Path(os.path.realpath(path))
    if path.exists():
        refuse_special(path, "name another file to write")
    with _temporary(path, path.stem, path.suffix, _make_file) as part:
        yield part
        part.replace(path)


@contextmanager
def all_files_or_none(folder: str | Path) -> Iterator[Path]:
    """Hand out an empty folder beside ``folder``; move its files there if the block succeeds.

    An error or Ctrl-C inside the block leaves ``folder`` as it was, with all results of before.
    Afterwards files of the same name are replaced; others that lie there stay. Raises InputError if
    ``folder`` is a file, or something cannot be written: a full disk, no permission.
    """
    folder = Path(folder)
    require(folder.is_dir() or not folder.exists(), f"{folder}: it is a file: name a folder")
    with _temporary(folder, folder.name, "", tempfile.mkdtemp) as part:
        yield part
        for file in sorted(path for path in part.rglob("*") if path.is_file()):
            place = folder / file.relative_to(part)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)


def _make_file(dir: Path, prefix: str, suffix: str) -> tuple[int, str]:
    """Make an empty file with the permissions of any new one, as :func:`tempfile.mkstemp`."""
    path = dir / f"{prefix}{secrets.token_hex(RANDOM // 2)}{suffix}"
    return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666), str(path)


@contextmanager
def _temporary(path: Path, stem: str, suffix: str, make: Callable[..., Any]) -> Iterator[Path]:
    """Hand out a temporary file or folder beside ``path``, and remove it in the end.

    It is locked while it is written, which a kill releases. Windows has no such lock (and renames
    no open file): there nothing is held.
    """
    prefix, ending, parent = f".{stem}.", f"{PART}{suffix}", path.parent
    part = number = None
    try:
        parent.mkdir(parents=True, exist_ok=True)
        _remove_orphans(parent, prefix, ending)
        made = make(dir=parent, prefix=prefix, suffix=ending)
        number, part = (None, Path(made)) if isinstance(made, str) else (made[0], Path(made[1]))
        if fcntl is None and number is not None:
            os.close(number)
            number = None
        elif fcntl is not None:
            number = os.open(part, os.O_RDONLY) if number is None else number
            with suppress(OSError):  # a file system without locks
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield part
    except OSError as error:
        raise InputError(
            f"{path}: it cannot be written ({error.strerror or error}): make room or name another "
            "place"
        ) from error
    finally:
        if number is not None:
            os.close(number)
        if part is not None:
            shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink(True)


def _remove_orphans(folder: Path, prefix: str, suffix: str) -> None:
    """Remove temporary files or folders of the same name whose writer was killed."""
    if fcntl is None:
        return
    length = len(prefix) + RANDOM + len(suffix)
    for orphan in folder.glob(f"{glob.escape(prefix)}*{glob.escape(suffix)}"):
        if len(orphan.name) != length or orphan.stat().st_mtime > time.time() - JUST_MADE:
            continue
        with suppress(OSError):
            number = os.open(orphan, os.O_RDONLY)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)  # refused while it is written
                shutil.rmtree(orphan) if orphan.is_dir() else orphan.unlink()
            finally:
                os.close(number)


def unreadable_or_unwritable(error: OSError) -> str:
    """Return the message of an operating system's error that nothing nearer has handled."""
    where = f"{error.filename}: " if error.filename else ""
    return (
        f"{where}a file cannot be read or written ({error.strerror or error}): make room, or "
        "check its permissions"
    )


def refuse_special(path: Path, instead: str = "copy its content into a file") -> None:
    """Refuse pipes, devices and broken links, on which opening would wait for ever."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file: check the path") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        circle = getattr(error, "errno", None) == errno.ELOOP
        what = "its links lead in a circle" if circle else f"it cannot be opened ({error})"
        raise InputError(f"{path}: {what}: name the file itself") from None
    require(not stat.S_ISDIR(mode), f"{path}: it is a folder: name a file in it")
    require(stat.S_ISREG(mode), f"{path}: it is a pipe or a device: {instead}")


def read_regular(path: Path, most: int = LONGEST_RECORD) -> bytes:
    """Return the content of a regular file, which may be untrusted.

    Raises OSError if it cannot be opened. Raises InputError if it is a pipe, a device or a folder,
    or longer than ``most`` bytes.
    """
    status = path.stat()
    regular = stat.S_ISREG(status.st_mode)
    require(regular, f"{path}: it is a folder, a pipe or a device: put a copy of the file there")
    require(status.st_size <= most, f"{path}: it is longer than {most:,} bytes: copy it again")
    return path.read_bytes()


def read_json(path: Path) -> Any:
    """Return the content of a JSON file; raises as :func:`read_regular`, ValueError if damaged."""
    try:
        return json.loads(read_regular(path))
    except RecursionError:
        raise ValueError("it nests too deeply") from None


def refuse_unfinished(path: Path) -> None:
    """Refuse a text whose last line does not end, since it may be cut inside its last number."""
    refuse_special(path)
    with path.open("rb") as file:
        if file.seek(0, os.SEEK_END):
            file.seek(-1, os.SEEK_END)
            if file.read(1) not in b"\r\n":
                raise InputError(
                    f"{path}: the last line has no line ending; its last number may be truncated: "
                    "copy the file again, or add a line ending if it is whole"
                )


def allowed_bytes(size: int) -> int:
    """Return the most bytes that arrays read from a file of ``size`` bytes may take."""
    return max(min(EXPANSION * size, FREELY), LARGE_EXPANSION * size) + ALLOWANCE


def check_size(path: Path, size: int, what: str) -> None:
    """Refuse ``size`` bytes of ``what`` if the file is too small for them."""
    own = path.stat().st_size
    require(
        size <= allowed_bytes(own),
        f"{path}: {what} would take {size / 2**20:,.0f} MiB, more than {EXPANSION} times the "
        f"file of {own / 2**20:,.1f} MiB may ask for: its header is damaged, copy it again",
    )


def npz_members(path: Path) -> set[str]:
    """Return names inside a zip archive; empty if it is none or damaged."""
    damage = (zipfile.BadZipFile, OSError, ValueError, NotImplementedError)
    with suppress(*damage), zipfile.ZipFile(path) as archive:
        return set(archive.namelist())
    return set()


def read_npz(path: Path, unpickle: Unpickle | None = None) -> dict[str, Any]:
    """Return all arrays of an ``.npz``, by name; ``unpickle`` is as of :func:`load_npy`.

    Raises InputError if it is none, damaged, holds a pickle, or asks for more memory than it may.
    """
    refuse_special(path)
    arrays, total = {}, 0
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            require(
                len({m.filename for m in members}) == len(members) <= MOST_MEMBERS,
                f"{path}: it holds {len(members):,} arrays, too many or two of one name: "
                "cut it in parts",
            )
            for member in members:
                name, total = member.filename, total + member.file_size
                check_size(path, total, name)
                plain = member.compress_type in PACKINGS
                require(plain, f"{path}: {name} is packed unusually: save it with np.savez")
                raw = archive.read(member)
                arrays[name.removesuffix(".npy")] = load_npy(raw, path, name, unpickle)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # whatever NumPy, zipfile and its decompressors raise
        raise InputError(
            f"{path}: it is not a plain npz archive, or damaged or cut short "
            f"({type(error).__name__}): copy it again"
        ) from None
    return arrays


def load_npy(raw: bytes, path: Path, member: str = "", unpickle: Unpickle | None = None) -> Any:
    """Return the array in an ``.npy`` stream; of objects, what ``unpickle`` makes of their pickle.

    Raises InputError if it is damaged, too large, or of another kind than numbers and text.
    """
    stream, place = io.BytesIO(raw), f"{path}: {member}" if member else str(path)
    try:
        version = np.lib.format.read_magic(stream)
        header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        shape, _, dtype = header(stream)
    except Exception as error:
        raise InputError(f"{place}: it is no npy array ({error}): copy it again") from None
    held = len(raw) - stream.tell()
    if dtype.kind == "O" and unpickle is not None:
        value = unpickle(raw[stream.tell() :], place)
        same = not isinstance(value, np.ndarray) or value.shape == shape
        require(same, f"{place}: its header and content differ in shape: copy it again")
        return value
    require(
        not dtype.hasobject,
        f"{place}: it holds a pickle of Python objects, which is never opened: check --source, or "
        "save numbers",
    )
    plain = dtype.kind in PLAIN_KINDS and dtype.fields is None
    require(plain, f"{place}: an array is of kind {dtype}: save plain numbers or text")
    count = math.prod(map(int, shape))
    size = count * dtype.itemsize
    require(
        size == held,
        f"{place}: its header announces {size:,} bytes and it holds {held:,}: copy it again",
    )
    check_size(path, size if dtype.kind in "SU" else count * 8, member or "its array")
    stream.seek(0)
    return checked_text(path, np.load(stream, allow_pickle=False))


def checked_text(path: Path, array: NDArray[Any]) -> NDArray[Any]:
    """Return the array; refuse text with characters that do not exist."""
    if array.dtype.kind == "U" and array.size and array.dtype.itemsize:
        codes = np.frombuffer(array.astype(array.dtype.newbyteorder("=")).tobytes(), np.uint32)
        exist = codes.max() <= sys.maxunicode
        require(exist, f"{path}: a text holds characters that do not exist: copy it again")
    return array


LONGEST = 64 * 2**10  # [bytes]
MOST_ALIASES = 32  # repeated within each other, a few dozen make a text of any size
DEEPEST = 50  # tables and lists within each other


def read_yaml(path: Path) -> Any:
    """Return the data in a YAML file.

    Raises InputError if it is no file, too long, not valid, names code, repeats itself too often,
    or gives a key twice.
    """
    refuse_special(path)
    short = path.stat().st_size <= LONGEST
    require(short, f"{path}: it is longer than {LONGEST:,} bytes: it is no file of settings")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: it cannot be read ({error}): check it") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, place: str) -> Any:
    """Return the data in a YAML text; ``place`` is for messages."""
    with require_extra("settings in YAML", "data"):
        import yaml

    class Loader(yaml.SafeLoader):
        depth = aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.aliases += self.check_event(yaml.AliasEvent)
            self.depth += 1
            most = f"{place}: it repeats itself by more than {MOST_ALIASES} aliases"
            require(self.aliases <= MOST_ALIASES, most)
            require(self.depth <= DEEPEST, f"{place}: it nests deeper than {DEEPEST}: flatten it")
            node = super().compose_node(parent, index)
            self.depth -= 1
            return node

        def compose_mapping_node(self, anchor: Any) -> Any:
            """Refuse a key that is given twice, of which YAML would silently take the last."""
            node = super().compose_mapping_node(anchor)
            lines: dict[tuple[str, str], int] = {}
            for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
                kind, line = (key.tag, key.value), key.start_mark.line + 1
                if kind in lines:
                    raise InputError(
                        f"{place}: line {line}: key {key.value!r} was given in line "
                        f"{lines[kind]} already: give it once"
                    )
                lines[kind] = line
            return node

    try:
        return yaml.load(text, Loader)
    except InputError:
        raise
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{place}: it is not valid YAML ({first}): correct it") from None
