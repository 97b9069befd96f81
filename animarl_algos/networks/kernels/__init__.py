"""Compiled loops of the networks for float32 on the CPU: acting, the GRU, the chosen action."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


def runs_compiled(tensor: torch.Tensor) -> bool:
    """Whether compiled loops (float32 on the CPU alone) can work on the tensor."""
    return tensor.dtype == torch.float32 and tensor.device.type == "cpu"


def as_arrays(*tensors: torch.Tensor) -> list[NDArray[Any]]:
    """Return contiguous arrays of the tensors, without copying those that are contiguous."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


class WeightViews:
    """The memory of parameters as NumPy arrays, looked up anew when parameters are moved."""

    def __init__(self, parameters: Sequence[torch.Tensor]) -> None:
        self.parameters = tuple(parameters)
        self._addresses: tuple[int, ...] = ()
        self._arrays: tuple[NDArray[np.float32], ...] = ()

    def arrays(self) -> tuple[NDArray[np.float32], ...]:
        """Return the present values without copying them."""
        addresses = tuple([p.data_ptr() for p in self.parameters])
        if addresses != self._addresses:
            self._arrays = tuple(p.detach().numpy() for p in self.parameters)
            self._addresses = addresses
        return self._arrays
