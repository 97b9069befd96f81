"""The project's own file, written by ``Demonstrations.save``."""

from __future__ import annotations

import zipfile
from pathlib import Path

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.readers.registry import register_reader

_MEMBERS = {"positions.npy", "lengths.npy", "initial_velocity.npy", "meta.npy"}


def npz_members(path: Path) -> set[str]:
    """Names inside a zip archive; empty if it is none or damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return set()


@register_reader(
    "animarl",
    "demonstrations of this project (.npz)",
    sniff=lambda path: npz_members(path) >= _MEMBERS,
    extensions=(".npz",),
)
def read_native(path: Path) -> Demonstrations:
    """Read a file written by :meth:`Demonstrations.save`."""
    return Demonstrations.load(path)
