"""Files of finished episodes: this project's demonstrations, and their exports to Minari."""

from pathlib import Path

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.files import npz_members
from animarl_envs.importing.minari_io import DATA_FILE, import_minari
from animarl_envs.importing.readers.registry import register_track_reader

OWN = {"positions.npy", "lengths.npy", "initial_velocity.npy", "meta.npy"}


@register_track_reader(
    "animarl",
    "demonstrations of this project (.npz)",
    sniff=lambda path: npz_members(path) >= OWN,
    extensions=(".npz",),
    finished=True,
)
def read_native(path: Path) -> Demonstrations:
    """Read a file written by :meth:`Demonstrations.save`."""
    return Demonstrations.load(path)


@register_track_reader(
    "minari",
    "a Minari dataset written by 'animarl data convert' (its folder, or the file in it)",
    sniff=lambda path: path.name == DATA_FILE or (path / "data" / DATA_FILE).is_file(),
    extensions=(".hdf5", ""),  # a folder has no suffix
    finished=True,
)
def read_minari(path: Path) -> Demonstrations:
    """Read the dataset back, exactly as it was exported."""
    return import_minari(path.parent.parent if path.name == DATA_FILE else path)
