"""Readers by the software that wrote the file: registered by name, found by looking at the file.

There are two kinds. Files that hold finished episodes are read straight into demonstrations. Files
of trackers are read into :class:`~animarl_envs.importing.tracks.Tracks` and pass through a recipe
(cleaning, scaling, cutting), for which such a reader may bring defaults.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import check_npz, refuse_special
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers.guards import naming, refusing
from animarl_envs.importing.readers.habits import what_to_type
from animarl_envs.importing.readers.hdf import is_hdf, open_hdf
from animarl_envs.importing.tracks import Tracks, merge, one_per_individual, told_apart

ReadDemonstrations = Callable[..., Demonstrations]
ReadTracks = Callable[..., list[Tracks]]
Sniff = Callable[[Path], bool]


@dataclass(frozen=True)
class Reader:
    """One source of recorded animals.

    ``sniff`` says from a look at the file whether it is of this source; it never raises. Either
    ``read_demonstrations`` or ``read_tracks`` is given; both take the path and options.
    ``defaults`` are recipe entries that fit what the source is. ``generic`` readers of arrays and
    tables are asked last, so that a tracker's own layout is recognised first.
    """

    name: str
    description: str
    extensions: tuple[str, ...]
    sniff: Sniff
    read_demonstrations: ReadDemonstrations | None = None
    read_tracks: ReadTracks | None = None
    defaults: Mapping[str, Any] = field(default_factory=dict)
    generic: bool = False

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the reader's options."""
        function = self.read_demonstrations or self.read_tracks
        assert function is not None
        return tuple(k for k in inspect.signature(function).parameters if k not in _NOT_OPTIONS)


TABLES = (".csv", ".tsv", ".txt", ".dat", ".asc", ".tab", ".xlsx", ".xlsm", ".xls", ".parquet")
_NOT_OPTIONS = ("path", "progress")
_READERS: dict[str, Reader] = {}


def register_reader(
    name: str, description: str, sniff: Sniff, extensions: Sequence[str]
) -> Callable[[ReadDemonstrations], ReadDemonstrations]:
    """Decorator: make a function ``read(path, **options) -> Demonstrations`` known by ``name``."""

    def register(function: ReadDemonstrations) -> ReadDemonstrations:
        _add(Reader(name, description, tuple(extensions), sniff, read_demonstrations=function))
        return function

    return register


def register_track_reader(
    name: str,
    description: str,
    sniff: Sniff,
    extensions: Sequence[str],
    defaults: Mapping[str, Any] | None = None,
    generic: bool = False,
) -> Callable[[ReadTracks], ReadTracks]:
    """Decorator: make a function ``read(path, **options) -> list[Tracks]`` known by ``name``.

    A function with a parameter ``progress`` is handed a callable that takes the share done.
    """

    def register(function: ReadTracks) -> ReadTracks:
        entries = dict(defaults or {})
        _add(Reader(name, description, tuple(extensions), sniff, None, function, entries, generic))
        return function

    return register


def available_readers() -> tuple[Reader, ...]:
    """All registered readers, by name."""
    return tuple(_READERS[name] for name in sorted(_READERS))


def get_reader(name: str) -> Reader:
    """The reader of that name, or one sentence that lists the names."""
    try:
        return _READERS[name]
    except KeyError:
        raise InputError(
            f"source {name!r} is unknown: choose one of "
            f"{', '.join(reader.name for reader in available_readers())}"
        ) from None


def find_reader(path: str | Path, source: str | None = None) -> Reader:
    """The reader named ``source``, or the one that recognises the file."""
    path = Path(path)
    if not path.is_dir():  # of Minari datasets
        refuse_special(path)
        if path.stat().st_size == 0:
            raise InputError(f"{path}: it is empty: copy the file again")
    if source is not None:
        return get_reader(source)
    for reader in sorted(available_readers(), key=lambda reader: reader.generic):
        if path.name.lower().endswith(reader.extensions) and reader.sniff(path):
            return reader
    refuse_special(path)
    if path.suffix.lower() == ".npz":
        check_npz(path)  # says so if it is damaged
    if is_hdf(path):
        open_hdf(path).close()  # says so if the extra is missing or the file is damaged
    if path.suffix.lower() in TABLES and (words := what_to_type(path)):
        raise InputError(f"{path}: no reader recognises it: {words}")
    raise InputError(
        f"{path}: no reader recognises it: name its --source "
        f"({', '.join(reader.name for reader in available_readers())})"
    )


def read(path: str | Path, source: str | None = None, **options: Any) -> Demonstrations:
    """Read demonstrations from one file.

    Parameters
    ----------
    path
        The file.
    source
        Name of the reader; by default the file is looked at to find it.
    options
        Handed to the reader; for a tracker's file also entries of the recipe, such as
        ``frame_rate``.

    Raises
    ------
    InputError
        If the file is missing, of no known source, or refused by its reader.
    """
    path = Path(path)
    reader = find_reader(path, source)
    if reader.read_demonstrations is not None:
        _check_options(reader, options)
        with refusing(path, reader.name):
            return reader.read_demonstrations(path, **options)
    own = {key: options.pop(key) for key in reader.options if key in options}
    return follow(default_recipe(reader, options=own, **options), [path])


def default_recipe(reader: Reader, **changes: Any) -> ImportRecipe:
    """The recipe that fits a tracker's files, with changes."""
    return ImportRecipe.from_dict(
        {**reader.defaults, "source": reader.name, **changes}, f"source {reader.name}"
    )


def read_tracks(
    path: str | Path,
    source: str | None = None,
    progress: Callable[[float], None] | None = None,
    **options: Any,
) -> list[Tracks]:
    """Read the recordings of one tracker's file, as they are."""
    path = Path(path)
    reader = find_reader(path, source)
    if reader.read_tracks is None:
        raise InputError(
            f"{path}: source {reader.name} holds finished episodes, not tracks: "
            "use it as it is, or convert it with 'animarl data convert'"
        )
    _check_options(reader, options)
    if progress is not None and "progress" in inspect.signature(reader.read_tracks).parameters:
        options["progress"] = progress
    with refusing(path, reader.name):
        return reader.read_tracks(path, **options)


def follow(
    recipe: ImportRecipe, files: Sequence[Path], progress: Callable[[float], None] | None = None
) -> Demonstrations:
    """The demonstrations that a recipe makes of a tracker's files.

    ``progress`` is told the share of the work done, 0 to 1.

    Raises
    ------
    InputError
        One sentence that names the file, the place and the remedy.
    """
    if not files:
        raise InputError("no file was given: name at least one")
    seen: set[Path] = set()
    parts: list[tuple[Path, Tracks]] = []
    for number, file in enumerate(files):
        if file.resolve() in seen:
            raise InputError(f"{file}: it is given twice: name it once")
        seen.add(file.resolve())
        told = _part_of(progress, number, len(files))
        found = read_tracks(file, recipe.source, progress=told, **recipe.options)
        parts += [(file, tracks) for tracks in found]
    name = str(files[0]) if len(files) == 1 else f"{files[0]} and {len(files) - 1} more"
    if recipe.merge_individuals:
        return demonstrations_from_tracks(
            merge(one_per_individual([tracks for _, tracks in parts])), recipe, name
        )
    parts = told_apart(parts)
    with naming({tracks.recording: file for file, tracks in parts}):
        return demonstrations_from_tracks(merge([tracks for _, tracks in parts]), recipe, name)


def _check_options(reader: Reader, options: Mapping[str, Any]) -> None:
    unknown = sorted(set(options) - set(reader.options))
    if unknown:
        known = ", ".join(reader.options) or "none"
        raise InputError(
            f"source {reader.name} has no option {unknown[0]!r}: its options are {known}"
        )


def _add(reader: Reader) -> None:
    if reader.name in _READERS:
        raise ValueError(f"reader {reader.name!r} is registered twice")
    _READERS[reader.name] = reader


def _part_of(
    progress: Callable[[float], None] | None, number: int, total: int
) -> Callable[[float], None] | None:
    if progress is None:
        return None
    return lambda share: progress((number + share) / total)
