"""The gradient reversal layer of adversarial treatment prediction (DQCIL).

Forward it is the identity; backward it multiplies the gradient by ``-strength``. The layers behind
it learn to predict the treatment, the layers before it learn to hide it
(Ganin et al. 2016; the paper, "Counterfactual imitation learning").
"""

from __future__ import annotations

from typing import Any

import torch


class _GradientReversal(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: torch.Tensor, strength: float) -> torch.Tensor:
        ctx.strength = strength
        return features.view_as(features)

    @staticmethod
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor, None]:
        return -ctx.strength * grad_outputs[0], None


def reverse_gradient(features: torch.Tensor, strength: float = 1.0) -> torch.Tensor:
    """Return ``features`` unchanged; their gradient comes back times ``-strength``."""
    out: torch.Tensor = _GradientReversal.apply(features, strength)  # type: ignore[no-untyped-call]
    return out
