"""The project's own file, written by ``Demonstrations.save``."""

from __future__ import annotations

from pathlib import Path

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.importing.readers.guards import check_npz, npz_members
from animarl_envs.importing.readers.registry import register_reader

_MEMBERS = {"positions.npy", "lengths.npy", "initial_velocity.npy", "meta.npy"}


@register_reader(
    "animarl",
    "demonstrations of this project (.npz)",
    sniff=lambda path: npz_members(path) >= _MEMBERS,
    extensions=(".npz",),
)
def read_native(path: Path) -> Demonstrations:
    """Read a file written by :meth:`Demonstrations.save`."""
    check_npz(path)
    return Demonstrations.load(path)
