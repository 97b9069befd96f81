"""Small batches of padded sequences, and PyTorch's own GRU, for tests of the stacked networks."""

import numpy as np
import torch
from torch import nn

K, T, B, N, H, A = 3, 7, 4, 5, 6, 4  # individuals, steps, sequences, components, units, actions
LENGTHS = np.array([[7, 5, 4, 1], [6, 6, 2, 2], [7, 3, 3, 0]])


def batch(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Observations ``(K, T, B, N)`` and previous actions ``(K, T, B)``, ``A`` for none."""
    generator = torch.Generator().manual_seed(seed)
    observations = torch.randn(K, T, B, N, generator=generator)
    previous = torch.randint(0, A + 1, (K, T, B), generator=generator)
    return observations, previous


def valid_steps(lengths: np.ndarray = LENGTHS) -> torch.Tensor:
    """``(K, T, B)``: the steps that are no padding."""
    return torch.from_numpy(np.arange(T)[None, :, None] < lengths[:, None, :])


def torch_gru(
    k: int,
    weight_input: torch.Tensor,
    weight_hidden: torch.Tensor,
    bias_input: torch.Tensor,
    bias_hidden: torch.Tensor,
) -> nn.GRU:
    """Individual k's weights in PyTorch's own GRU."""
    _, inputs, units = weight_input.shape
    reference = nn.GRU(inputs, units // 3).to(weight_input.device, weight_input.dtype)
    with torch.no_grad():
        reference.weight_ih_l0.copy_(weight_input[k].T)
        reference.weight_hh_l0.copy_(weight_hidden[k].T)
        reference.bias_ih_l0.copy_(bias_input[k, 0])
        reference.bias_hh_l0.copy_(bias_hidden[k, 0])
    return reference
