"""A Minari dataset that this project wrote (its ``main_data.hdf5``, or the folder around it)."""

from __future__ import annotations

from pathlib import Path

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.importing.minari_io import DATA_FILE, import_minari
from animarl_envs.importing.readers.registry import register_reader


@register_reader(
    "minari",
    "a Minari dataset written by 'animarl data convert' (its folder, or the file in it)",
    sniff=lambda path: path.name == DATA_FILE or (path / "data" / DATA_FILE).is_file(),
    extensions=(".hdf5", ""),  # a folder has no suffix
)
def read_minari(path: Path) -> Demonstrations:
    """Read the dataset back, exactly as it was exported."""
    return import_minari(path.parent.parent if path.name == DATA_FILE else path)
