"""Compiled forms of the networks: forward, backward and acting, for float32 on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from numpy.typing import NDArray


def runs_compiled(tensor: torch.Tensor) -> bool:
    """Whether compiled loops (float32 on the CPU alone) can work on the tensor."""
    return tensor.dtype == torch.float32 and tensor.device.type == "cpu"


def as_arrays(*tensors: torch.Tensor) -> list[NDArray[Any]]:
    """Return contiguous arrays of the tensors, without copying those that are contiguous."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]
