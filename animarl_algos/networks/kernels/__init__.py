"""Compiled forms of the networks: forward, backward and acting, for float32 on the CPU."""

from __future__ import annotations

import torch


def runs_compiled(tensor: torch.Tensor) -> bool:
    """Whether compiled loops (float32 on the CPU alone) can work on the tensor."""
    return tensor.dtype == torch.float32 and tensor.device.type == "cpu"
