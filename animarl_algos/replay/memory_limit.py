"""Refuse to allocate more memory than the machine can give, before anything is allocated."""

from __future__ import annotations

import os
from pathlib import Path

from animarl_envs.errors import InputError

_MEMINFO = Path("/proc/meminfo")
_GIB = 2**30


def available_memory() -> int | None:
    """Bytes that can be allocated without swapping; ``None`` where the system does not say."""
    if _MEMINFO.is_file():
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    names = getattr(os, "sysconf_names", {})
    if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def refuse_too_large(nbytes: int, setting: str) -> None:
    """Raise :class:`InputError` if ``nbytes`` exceed the available memory.

    ``setting`` names what asks for so much, such as ``"buffer_size 1000000"``.
    """
    available = available_memory()
    if available is not None and nbytes > available:
        raise InputError(
            f"the replay memory for {setting} needs {nbytes / _GIB:.1f} GiB but "
            f"{available / _GIB:.1f} GiB are available: lower it"
        )
