"""Readers by the software that wrote the file: registered by name, found by looking at the file.

There are two kinds. Files that hold finished episodes are read straight into demonstrations. Files
of trackers are read into :class:`~animarl_envs.importing.tracks.Tracks` and pass through a recipe
(cleaning, scaling, cutting), for which such a reader may bring defaults.
"""

import contextlib
import inspect
import runpy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs import wall
from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import (
    FaultCollector,
    InputError,
    MissingExtraError,
    join_errors,
    printable,
    require,
    sentences_of,
)
from animarl_envs.files import read_npz, refuse_special
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.hdf import is_hdf, open_hdf
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.tables import Progress, clear_caches
from animarl_envs.importing.tracks import (
    Tracks,
    disambiguate_by_folder,
    merge,
    one_per_individual,
    separate_arenas,
)

Read = Callable[..., Demonstrations | list[Tracks]]
# Seconds and bytes that a file may take beyond those of any file, by its size.
BYTES_PER_SECOND, MEMORY_PER_BYTE = 5_000_000, 24


@dataclass(frozen=True)
class Reader:
    """One source of recorded animals.

    ``sniff`` says from a look at the file whether it is of this source; it never raises.
    ``function`` takes the path and options; it returns demonstrations if ``finished``, else a list
    of tracks. ``defaults`` are recipe entries that fit what the source is. ``generic`` readers of
    arrays and tables are asked last, so that a tracker's own layout is recognised first.
    ``explain`` says of a file with its ending that no reader recognises what to do about it.
    """

    name: str
    description: str
    extensions: Sequence[str]
    sniff: Callable[[Path], bool]
    function: Read
    finished: bool = False
    defaults: Mapping[str, Any] = field(default_factory=dict)
    generic: bool = False
    explain: Callable[[Path], str | None] | None = None

    @property
    def is_own(self) -> bool:
        """Whether it is of this project; others are users' code and run in this process."""
        return str(self.function.__module__).startswith("animarl_envs.")

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the reader's options."""
        return tuple(name for name in self._parameters if name not in ("path", "progress"))

    @property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(self.function).parameters

    def read(
        self, path: Path, options: dict[str, Any], progress: Progress = None
    ) -> Demonstrations | list[Tracks]:
        """Read a file, those of other software in a process of its own."""
        unknown = sorted(set(options) - set(self.options))
        if unknown:
            known = ", ".join(self.options) or "none"
            raise InputError(
                f"source {self.name} has no option {unknown[0]!r}: its options are {known}"
            )
        if "progress" not in self._parameters:
            progress = None
        if not self.is_own or self.name == "animarl":
            with _one_sentence_for(path, self.name):
                if progress is not None:
                    options = options | {"progress": progress}
                return self.function(path, **options)
        result = _call_behind_wall(_read_as_plain_data, path, self.name, options, progress=progress)
        if isinstance(result, dict):
            return Demonstrations(**result | {"arena": Arena(**result["arena"])})
        return [Tracks(**record) for record in result]


_READERS: dict[str, Reader] = {}


def _source_of(function: Read) -> str:
    """Return the file in which a function is written."""
    return inspect.getsourcefile(function) or ""


def register_track_reader(name: str, description: str, **more: Any) -> Callable[[Read], Read]:
    """Register a function ``read(path, **options) -> list[Tracks]`` under ``name`` (a decorator).

    A function with a parameter ``progress`` is handed a callable that takes the share done. One
    that reads ``finished`` episodes returns demonstrations. ``more`` are the further fields of a
    :class:`Reader`.
    """

    def register(function: Read) -> Read:
        if name in _READERS and _source_of(_READERS[name].function) != _source_of(function):
            raise ValueError(f"reader {name!r} is registered twice")
        _READERS[name] = Reader(name, description, function=function, **more)
        return function

    return register


def available_readers() -> tuple[Reader, ...]:
    """Return all registered readers, by name."""
    return tuple(_READERS[name] for name in sorted(_READERS))


def get_reader(name: str) -> Reader:
    """Return the reader of that name; refuse an unknown one with a list of the names."""
    if name not in _READERS:
        known = ", ".join(sorted(_READERS))
        raise InputError(f"source {name!r} is unknown: choose one of {known}")
    return _READERS[name]


def load_readers(path: Path) -> None:
    """Run a Python file of your own, which registers readers by :func:`register_track_reader`."""
    refuse_special(path)
    try:
        runpy.run_path(str(path.resolve()))
    except Exception as error:
        raise InputError(
            f"{path}: it cannot be run ({type(error).__name__}: {error}): correct it"
        ) from error


def find_reader(path: str | Path, source: str | None = None) -> Reader:
    """Return the reader named ``source``, or the one that recognises the file."""
    path = Path(path)
    if not path.is_dir():  # of Minari datasets
        refuse_special(path)
        if path.stat().st_size == 0:
            raise InputError(f"{path}: it is empty: copy the file again")
    if source is not None:
        return get_reader(source)
    for reader in available_readers():
        fits = not reader.is_own and path.name.lower().endswith(tuple(reader.extensions))
        if fits and reader.sniff(path):
            return reader
    if path.is_dir() or path.suffix.lower() == ".npz":  # looked at without any library
        return get_reader(_find_own_reader(path))
    return get_reader(_call_behind_wall(_find_own_reader, path))


def files_in(paths: Sequence[Path]) -> list[Path]:
    """Return files, and of each folder all files whose endings are those of a reader.

    A folder that is a Minari dataset stays as it is.
    """
    endings = tuple(ending for one in available_readers() for ending in one.extensions if ending)
    files: list[Path] = []
    for path in paths:
        if not path.is_dir() or get_reader("minari").sniff(path):
            files.append(path)
            continue
        inside = sorted(one for one in path.iterdir() if not one.name.startswith("."))
        own = [one for one in inside if one.name.lower().endswith(endings) and not one.is_dir()]
        require(own, f"{path}: no file in the folder has the ending of a reader: name the files")
        files += own
    return files


def _find_own_reader(path: Path) -> str:
    """Return the name of this project's reader that recognises the file."""
    own = [reader for reader in available_readers() if reader.is_own]
    for reader in sorted(own, key=lambda reader: reader.generic):
        if path.name.lower().endswith(tuple(reader.extensions)) and reader.sniff(path):
            return reader.name
    refuse_special(path)
    suffix = path.suffix.lower()
    with _one_sentence_for(path, suffix):  # says so if an extra is missing or it is damaged
        if suffix == ".npz":
            read_npz(path)
        if is_hdf(path):
            open_hdf(path).close()
        words = [one.explain(path) for one in own if one.explain and suffix in one.extensions]
    known = ", ".join(reader.name for reader in own)
    remedy = next(filter(None, words), f"name its --source ({known})")
    raise InputError(f"{path}: no reader recognises it: {remedy}")


def read(path: str | Path, source: str | None = None, **options: Any) -> Demonstrations:
    """Read demonstrations from one file by the reader ``source``, by default found by a look at it.

    ``options`` are handed to the reader; for a tracker's file also entries of the recipe, such as
    ``frame_rate``. Raises InputError if the file is missing, of no known source, or refused.
    """
    path = Path(path)
    reader = find_reader(path, source)
    if reader.finished:
        result = reader.read(path, options)
        assert isinstance(result, Demonstrations)
        return result
    own = {key: options.pop(key) for key in reader.options if key in options}
    return follow(default_recipe(reader, options=own, **options), [path])


def default_recipe(reader: Reader, **changes: Any) -> ImportRecipe:
    """Return the recipe that fits a tracker's files, with changes."""
    return ImportRecipe.from_dict(
        {**reader.defaults, "source": reader.name, **changes}, f"source {reader.name}"
    )


def read_tracks(
    path: str | Path, source: str | None = None, progress: Progress = None, **options: Any
) -> list[Tracks]:
    """Read the recordings of one tracker's file, as they are."""
    path = Path(path)
    reader = find_reader(path, source)
    if reader.finished:
        raise InputError(
            f"{path}: source {reader.name} holds finished episodes, not tracks: "
            "use it as it is, or convert it with 'animarl data convert'"
        )
    result = reader.read(path, options, progress)
    assert isinstance(result, list)
    return result


def _read_as_plain_data(path: Path, name: str, options: dict[str, Any], **more: Any) -> Any:
    """Return tracks or demonstrations as plain values and arrays."""
    with _one_sentence_for(path, name):
        result = get_reader(name).function(path, **options, **more)
    clear_caches()
    if isinstance(result, Demonstrations):
        record = {one.name: getattr(result, one.name) for one in fields(result) if one.init}
        return record | {"arena": vars(result.arena)}
    return [vars(tracks) for tracks in result]


def _call_behind_wall(
    function: Callable[..., Any], path: Path, *more: Any, progress: Progress = None
) -> Any:
    size = path.stat().st_size
    return wall.call(
        function,
        path,
        *more,
        what=str(path),
        progress=progress,
        memory=wall.MEMORY + MEMORY_PER_BYTE * size,
        seconds=wall.SECONDS + size // BYTES_PER_SECOND,
    )


def numbers(path: Path, name: str, array: NDArray[Any], *shape: int | str) -> Floats:
    """Return an array of numbers of this shape as float64; a named axis has any length."""
    fits = array.ndim == len(shape) and array.dtype.kind in "iuf"
    require(
        fits and all(n in (m, str(n)) for n, m in zip(shape, array.shape, strict=True)),
        f"{path}: {name} is {array.dtype} of shape {array.shape}, not numbers of shape "
        f"({', '.join(map(str, shape))}): check --source, or export it again",
    )
    return array.astype(np.float64)


@contextlib.contextmanager
def _one_sentence_for(path: Path, source: str) -> Iterator[None]:
    """Turn what a library raises over a damaged file into one sentence."""
    try:
        yield
    except (MissingExtraError, MemoryError):
        raise
    except InputError as error:
        if printable(str(path)) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None
    except IsADirectoryError:
        raise InputError(f"{path}: it is a folder: name a file in it") from None
    except Exception as error:
        first = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        raise InputError(
            f"{path}: it cannot be read as {source} ({type(error).__name__}: {first}): "
            "check --source, or copy the file again"
        ) from error


def follow(
    recipe: ImportRecipe, files: Sequence[Path], progress: Progress = None
) -> Demonstrations:
    """Return the demonstrations that a recipe makes of a tracker's files.

    ``progress`` is called with the share of the work done, 0 to 1.

    Raises InputError: one sentence that names the file, the place and the remedy.
    """
    if not files:
        raise InputError("no file was given: name at least one")
    seen: set[Path] = set()
    parts: list[tuple[Path, Tracks]] = []
    faults = FaultCollector()
    for number, file in enumerate(files):
        if file.resolve() in seen:
            raise InputError(f"{file}: it is given twice: name it once")
        seen.add(file.resolve())

        def report(share: float, number: int = number) -> None:
            if progress is not None:
                progress((number + share) / len(files))

        with faults.collect():
            result = read_tracks(file, recipe.source, progress=report, **recipe.options)
            parts += [(file, tracks) for tracks in result]
    faults.refuse()
    name = str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
    if recipe.merge_individuals:
        parts_of_one = one_per_individual([tracks for _, tracks in parts])
        return demonstrations_from_tracks(merge(parts_of_one), recipe, name)
    parts = disambiguate_by_folder(separate_arenas(parts))
    try:
        return demonstrations_from_tracks(merge([tracks for _, tracks in parts]), recipe, name)
    except InputError as error:  # put the file before a sentence about a recording
        sentences = [InputError(_with_file(one, parts)) for one in sentences_of(error)]
        if [str(one) for one in sentences] == sentences_of(error):
            raise
        raise join_errors(sentences) from None


def _with_file(sentence: str, parts: Sequence[tuple[Path, Tracks]]) -> str:
    """Return a sentence about a recording with the file of the recording before it."""
    for file, tracks in parts:
        if sentence.startswith((f"{tracks.recording}: ", f"{tracks.recording}, ")):
            return f"{file}: {sentence}"
    return sentence
