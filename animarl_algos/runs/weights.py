"""The weights of a trained policy as a file: torch's own within a run, safetensors to give away."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from animarl_algos.learner.checkpoint import load_tensors
from animarl_envs.errors import MissingExtraError
from animarl_envs.files import write_then_rename

OWN, GIVEN = ".pt", ".safetensors"


def weights_file(folder: Path, name: str) -> Path:
    """Where the weights of a policy lie, or would."""
    given = folder / f"{name}{GIVEN}"
    return given if given.exists() else folder / f"{name}{OWN}"


def read_weights(file: Path) -> Any:
    """Tensors by name.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged, or holds more than tensors and plain values.
    """
    if file.suffix != GIVEN:
        return load_tensors(file)
    formats = _safetensors()
    content = file.read_bytes()
    try:
        return formats.load(content)
    except Exception as error:  # safetensors' own, and torch's on a shape that is none
        raise ValueError(f"{file.name} is no whole file of tensors ({error})") from error


def write_weights(tensors: Mapping[str, torch.Tensor], file: Path) -> None:
    """Write tensors by name as safetensors, which hold no code."""
    formats = _safetensors()
    plain = {name: one.detach().cpu().contiguous() for name, one in tensors.items()}
    with write_then_rename(file) as part:
        part.write_bytes(formats.save(plain))


def _safetensors() -> Any:
    try:
        from safetensors import torch as formats
    except ImportError as error:
        raise MissingExtraError("a model as safetensors", "algos") from error
    return formats
