"""Readers: files of trackers and of other projects become demonstrations."""

from animarl_envs.importing.readers import (
    arrays,
    authors,
    deeplabcut,
    matlab_structs,
    movement,
    published,
    sleap,
    table_files,
    trackers,
)
from animarl_envs.importing.readers.registry import (
    Reader,
    available_readers,
    default_recipe,
    files_in,
    find_reader,
    follow,
    get_reader,
    load_readers,
    read,
    read_tracks,
    register_track_reader,
)

__all__ = [
    "Reader",
    "arrays",
    "authors",
    "available_readers",
    "deeplabcut",
    "default_recipe",
    "files_in",
    "find_reader",
    "follow",
    "get_reader",
    "load_readers",
    "matlab_structs",
    "movement",
    "published",
    "read",
    "read_tracks",
    "register_track_reader",
    "sleap",
    "table_files",
    "trackers",
]
