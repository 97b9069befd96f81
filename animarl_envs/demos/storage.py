"""Demonstrations on disk: an ``.npz`` of plain arrays and one JSON text, never a pickle."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

FORMAT = "animarl-demonstrations"
FORMAT_VERSION = 1


def save(demos: Demonstrations, path: str | Path, *, dtype: type[np.floating] = np.float64) -> Path:
    """Write ``demos``: to a temporary file first, then renamed.

    ``dtype=np.float32`` halves the size; positions are then rounded to about 6e-8.
    """
    path = Path(path)
    meta = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "species": demos.species,
        "individuals": demos.individuals,
        "roles": demos.roles,
        "dt": demos.dt,
        "arena": vars(demos.arena) | {"boundary": _jsonable(demos.arena.boundary)},
        "provenance": dict(demos.provenance),
    }
    arrays: dict[str, NDArray[Any]] = {
        "positions": demos.positions.astype(dtype),
        "lengths": demos.lengths.astype(np.int32),
        "initial_velocity": demos.initial_velocity.astype(dtype),
        "condition": demos.condition,
        "outcome": demos.outcome,
        "split": demos.split,
        "recording": demos.recording,
        "meta": np.array(json.dumps(meta)),
    }
    arrays |= {f"signal_{key}": value for key, value in demos.signals.items()}
    with write_then_rename(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return path


def load(path: str | Path) -> Demonstrations:
    """Read a file written by :func:`save`.

    Raises
    ------
    InputError
        If the file is missing, truncated, of another format, or holds a pickle.
    """
    path = Path(path)
    arrays = read_npz(path)
    if "meta" not in arrays or FORMAT not in str(arrays["meta"]):
        raise InputError(
            f"{path}: it is not a demonstrations file of this project: make one with "
            "'animarl import', or name its --source"
        )
    try:
        meta = json.loads(str(arrays["meta"]))
        if meta["version"] > FORMAT_VERSION:
            raise InputError(
                f"{path}: format version {meta['version']} is newer than this animarl: upgrade it"
            )
        arena = dict(meta["arena"])
        arena["boundary"] = float(arena["boundary"])
        return Demonstrations(
            species=meta["species"],
            individuals=tuple(meta["individuals"]),
            roles=tuple(meta["roles"]),
            dt=float(meta["dt"]),
            arena=Arena(**arena),
            positions=arrays["positions"],
            lengths=arrays["lengths"],
            initial_velocity=arrays["initial_velocity"],
            condition=arrays["condition"],
            outcome=arrays["outcome"],
            split=arrays["split"],
            recording=arrays["recording"],
            signals={k[7:]: v for k, v in arrays.items() if k.startswith("signal_")},
            provenance=meta["provenance"],
            name=str(path),
        )
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{path}: its content is damaged ({type(error).__name__}: {error}): "
            "make it again with 'animarl import'"
        ) from error


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an ``.npz`` without pickle, or one sentence that says why not."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(
                    f"{path}: it is a single array, not an npz archive: save it with np.savez"
                )
            return {key: archive[key] for key in archive.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file: check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: it is a folder: name a file in it") from None
    except (zipfile.BadZipFile, EOFError, OSError, zipfile.LargeZipFile) as error:
        raise InputError(
            f"{path}: the archive is damaged or cut short ({error}): copy it again"
        ) from None
    except ValueError as error:
        if "pickle" in str(error).lower():
            raise InputError(
                f"{path}: it is not a plain npz archive or holds a pickle, which is never opened "
                "here: save plain arrays with np.savez"
            ) from None
        raise InputError(
            f"{path}: it cannot be read ({error}): save it again with np.savez"
        ) from None


def _jsonable(value: float) -> float | str:
    return value if np.isfinite(value) else "inf"
