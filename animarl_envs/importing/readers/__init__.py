"""Readers: files of trackers and of other projects become demonstrations."""

from animarl_envs.importing.readers import (
    agents,
    arrays,
    authors,
    collections,
    deeplabcut,
    ethovision,
    long_tables,
    mothvr,
    movement_tables,
    own,
    sleap,
    trackers,
    wide_tables,
)
from animarl_envs.importing.readers.registry import (
    Reader,
    available_readers,
    default_recipe,
    find_reader,
    follow,
    get_reader,
    read,
    read_tracks,
    register_reader,
    register_track_reader,
)

__all__ = [
    "Reader", "agents", "arrays", "authors", "available_readers", "collections", "deeplabcut",
    "default_recipe", "ethovision", "find_reader", "follow", "get_reader", "long_tables", "mothvr",
    "movement_tables", "own", "read", "read_tracks", "register_reader", "register_track_reader",
    "sleap", "trackers", "wide_tables",
]  # fmt: skip
