"""Readers: files of trackers and of other projects become demonstrations."""

from animarl_envs.demos.readers import agents, native
from animarl_envs.demos.readers.registry import (
    Reader,
    available_readers,
    get_reader,
    read,
    register_reader,
)

__all__ = [
    "Reader", "agents", "available_readers", "get_reader", "native", "read", "register_reader",
]  # fmt: skip
