"""Readers: files of trackers and of other projects become demonstrations."""

from animarl_envs.importing.readers import arrays, published, table_files, trackers
from animarl_envs.importing.readers.registry import (
    Reader,
    available_readers,
    default_recipe,
    find_reader,
    follow,
    get_reader,
    read,
    read_tracks,
    register_track_reader,
)

__all__ = [
    "Reader", "arrays", "available_readers", "default_recipe", "find_reader", "follow",
    "get_reader", "published", "read", "read_tracks", "register_track_reader", "table_files",
    "trackers",
]  # fmt: skip
