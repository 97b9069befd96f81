"""What lies in a run's folder: weights, and what the run was made with and on."""

import importlib.metadata
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from animarl_algos.learner.checkpoint import LARGEST_WEIGHTS, load_tensors
from animarl_envs.errors import require_extra
from animarl_envs.files import read_regular, write_then_rename

OWN, GIVEN = ".pt", ".safetensors"
"""Weights: torch's own within a run, safetensors, which hold no code, to give away."""
PACKAGES = (
    "animarl",
    "gymnasium",
    "numba",
    "numpy",
    "pettingzoo",
    "sb3-contrib",
    "scipy",
    "stable-baselines3",
    "torch",
)


def write_json(file: Path, content: Any) -> None:
    """Write a file whole or not at all."""
    with write_then_rename(file) as part:
        part.write_text(json.dumps(content, indent=2) + "\n")


# -- weights --------------------------------------------------------------------------------------


def weights_file(folder: Path, name: str) -> Path:
    """Return where the weights of a policy lie, or would."""
    given = folder / f"{name}{GIVEN}"
    return given if given.exists() else folder / f"{name}{OWN}"


def read_weights(file: Path) -> Any:
    """Return tensors by name.

    Raises OSError if the file cannot be read. Raises ValueError if it is damaged, or holds more
    than tensors and plain values.
    """
    if file.suffix != GIVEN:
        return load_tensors(file)
    formats, content = _safetensors(), read_regular(file, LARGEST_WEIGHTS)
    try:
        return formats.load(content)
    except Exception as error:  # safetensors' own, and torch's on a shape that is none
        raise ValueError(f"{file.name} is no whole file of tensors ({error})") from error


def write_weights(tensors: Mapping[str, torch.Tensor], file: Path) -> None:
    """Write tensors by name as safetensors."""
    plain = {name: one.detach().cpu().contiguous() for name, one in tensors.items()}
    with write_then_rename(file) as part:
        part.write_bytes(_safetensors().save(plain))


def _safetensors() -> Any:
    with require_extra("a model as safetensors", "algos"):
        from safetensors import torch as formats
    return formats


# -- versions and machine -------------------------------------------------------------------------


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages that decide a result."""
    packages = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | packages


def machine() -> dict[str, str]:
    """Return commit, system, processor and accelerator, as texts."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = models[0] if models else platform.processor() or platform.machine()
    accelerator = torch.cuda.get_device_name() if torch.cuda.is_available() else "none"
    return {
        "commit": commit(Path(__file__).resolve().parents[2]),
        "system": f"{platform.system()} {platform.machine()}",
        "processor": f"{processor}, {os.cpu_count()} logical cores",
        "accelerator": accelerator,
    }


def commit(root: Path) -> str:
    """Return the commit that the code in ``root`` stands at, and whether it was changed since."""
    if not (root / ".git").exists():
        return "none (an installed package, no checkout)"
    query = [
        "git",
        "-C",
        str(root),
        "describe",
        "--always",
        "--exclude=*",
        "--abbrev=40",
        "--dirty= with changes",
    ]
    try:
        return subprocess.run(query, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown (git did not tell)"
