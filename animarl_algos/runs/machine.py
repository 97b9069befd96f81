"""What a run was made with and on: the code's commit, the processor, the accelerator; how long."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from animarl_envs.files import write_then_rename

TIMES = "wall_time.json"


def machine() -> dict[str, str]:
    """Commit, system, processor and accelerator, as texts."""
    accelerator = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    return {
        "commit": commit(Path(__file__).resolve().parents[2]),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": f"{_processor()}, {os.cpu_count()} logical cores",
        "accelerator": accelerator,
    }


def commit(root: Path) -> str:
    """The commit that the code in ``root`` stands at, and whether it was changed since."""
    if not (root / ".git").exists():
        return "none (an installed package, no checkout)"
    try:
        head = _git(root, "rev-parse", "HEAD")
        changed = _git(root, "status", "--porcelain", "--untracked-files=no")
    except (OSError, subprocess.CalledProcessError):
        return "unknown (git did not tell)"
    return f"{head} with changes" if changed else head


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(
        ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def _processor() -> str:
    """Its name where the system tells it."""
    told = Path("/proc/cpuinfo")
    if told.exists():
        for line in told.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@contextmanager
def timed(folder: Path, stage: str) -> Iterator[None]:
    """Add the wall time of what is done within it to that of its stage in a run's folder.

    A stage that was interrupted and goes on later has the time of all its parts that came to their
    end.
    """
    begun = time.monotonic()
    yield
    times = wall_times(folder)
    times[stage] = times.get(stage, 0.0) + time.monotonic() - begun
    with write_then_rename(folder / TIMES) as part:
        part.write_text(json.dumps(times, indent=2) + "\n")


def wall_times(folder: Path) -> dict[str, float]:
    """Seconds by stage; none of a run from before they were kept."""
    file = folder / TIMES
    return (
        {str(k): float(v) for k, v in json.loads(file.read_text()).items()} if file.exists() else {}
    )
