"""Demonstrations on disk: an ``.npz`` of plain arrays and one JSON text, never a pickle."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz, write_then_rename

FORMAT = "animarl-demonstrations"
FORMAT_VERSION = 1
_DAMAGE = (LookupError, TypeError, ValueError, AttributeError, RecursionError, OverflowError)


def save(
    fields: Mapping[str, Any], path: str | Path, *, dtype: type[np.floating] = np.float64
) -> Path:
    """Write the fields of demonstrations: to a temporary file first, then renamed.

    ``dtype=np.float32`` halves the size; positions are then rounded to about 6e-8.
    """
    path = Path(path)
    arena: Arena = fields["arena"]
    meta = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        **{name: fields[name] for name in ("species", "individuals", "roles", "dt")},
        "arena": vars(arena) | {"boundary": _jsonable(arena.boundary)},
        "provenance": dict(fields["provenance"]),
    }
    arrays: dict[str, NDArray[Any]] = {
        "positions": fields["positions"].astype(dtype),
        "lengths": fields["lengths"].astype(np.int32),
        "initial_velocity": fields["initial_velocity"].astype(dtype),
        **{name: fields[name] for name in ("condition", "outcome", "split", "recording")},
        "meta": np.array(json.dumps(meta)),
    }
    arrays |= {f"signal_{key}": value for key, value in fields["signals"].items()}
    with write_then_rename(path) as part, part.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return path


def load(path: str | Path) -> dict[str, Any]:
    """The fields of demonstrations in a file written by :func:`save`; to be made within
    :func:`refusing_damage`.

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
    meta = json.loads(str(arrays["meta"]))
    if meta["version"] > FORMAT_VERSION:
        raise InputError(
            f"{path}: format version {meta['version']} is newer than this animarl: upgrade it"
        )
    arena = dict(meta["arena"])
    arena["boundary"] = float(arena["boundary"])
    whole = ("positions", "lengths", "initial_velocity", "condition", "outcome", "split")
    return {
        "species": meta["species"],
        "individuals": tuple(meta["individuals"]),
        "roles": tuple(meta["roles"]),
        "dt": float(meta["dt"]),
        "arena": Arena(**arena),
        **{name: arrays[name] for name in (*whole, "recording")},
        "signals": {k[7:]: v for k, v in arrays.items() if k.startswith("signal_")},
        "provenance": meta["provenance"],
        "name": str(path),
    }


@contextmanager
def refusing_damage(path: str | Path) -> Iterator[None]:
    """Turn what the content of a damaged file raises into one sentence."""
    try:
        yield
    except InputError:
        raise
    except (
        KeyError,
        TypeError,
        ValueError,
        AttributeError,
        RecursionError,
        OverflowError,
    ) as error:
        raise InputError(
            f"{path}: its content is damaged ({type(error).__name__}: {error}): "
            "make it again with 'animarl import'"
        ) from error


def _jsonable(value: float) -> float | str:
    return value if np.isfinite(value) else "inf"
