"""Means of losses per individual, the gradient reversal layer, and clipping per individual.

A loss is averaged over the valid steps of the individual itself, so that summing the losses of all
individuals gives each the gradient it would have if trained alone.

Axes are (individual K, time T, batch B). Losses take ``valid`` ``(K, T, B)`` bool, False on padded,
burnt-in and warm-up steps, and maybe ``weights`` ``(K, B)``, importance-sampling weights; they
return ``(K,)``, 0 for an individual without valid steps.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch


def masked_mean(
    per_step: torch.Tensor, valid: torch.Tensor, weights: torch.Tensor | None = None
) -> torch.Tensor:
    """Mean of ``per_step`` (K, T, B) over each individual's valid steps.

    Whatever stands on other steps leaves the mean alone; its gradient is zero, provided that what
    the loss was made of there is finite. Weights scale the loss and not the divisor, which stays
    the number of valid steps.
    """
    kept = torch.where(valid, per_step, per_step.new_zeros(()))
    if weights is not None:
        kept = kept * weights.unsqueeze(1)
    return kept.sum((1, 2)) / valid.sum((1, 2)).clamp(min=1)


@torch.no_grad()
def treatment_counts(
    logits: torch.Tensor, condition: torch.Tensor, valid: torch.Tensor
) -> torch.Tensor:
    """Count the valid steps of each treatment and those whose treatment is predicted; sums add up.

    ``logits`` are (K, T, B), ``condition`` (K, B), 0 or 1. Returns (K, 2, 2) int64, axes
    (individual, treatment, (predicted rightly, all)).
    """
    condition = condition.unsqueeze(1) > 0
    members = torch.stack([valid & ~condition, valid & condition], dim=1)
    right = members & ((logits > 0) == condition).unsqueeze(1)
    return torch.stack([right.sum((2, 3)), members.sum((2, 3))], dim=-1)


def mean_recall(counts: torch.Tensor) -> torch.Tensor:
    """Balanced accuracy, (K,), from :func:`treatment_counts`: the mean of both treatments' recalls.

    0.5 is chance; NaN where only one treatment occurs.
    """
    return (counts[..., 0] / counts[..., 1]).mean(-1)


@torch.no_grad()
def share_gradients(parameters: Iterable[torch.Tensor]) -> None:
    """Give every individual the mean of all individuals' gradients of ``parameters`` (K, ...).

    Weights that are the same for all then stay so under any optimiser.
    """
    for parameter in parameters:
        if parameter.grad is not None:
            parameter.grad.copy_(parameter.grad.mean(0, keepdim=True).expand_as(parameter))


@torch.no_grad()
def clip_grad_norm_per_individual(
    parameters: Iterable[torch.Tensor], max_norm: float
) -> torch.Tensor:
    """Scale each individual's gradient down to a Euclidean norm of at most ``max_norm``.

    As :func:`torch.nn.utils.clip_grad_norm_`, for every individual of ``parameters`` (K, ...)
    separately. Returns the norms before clipping, (K,).
    """
    gradients = [p.grad for p in parameters if p.grad is not None]
    if not gradients:
        return torch.zeros(0)
    together = torch.cat([g.flatten(1) for g in gradients], dim=1)
    total: torch.Tensor = torch.linalg.vector_norm(together, dim=1)
    if (total > max_norm - 1e-6).any():  # not the largest: a NaN would hide the others
        scale = (max_norm / (total + 1e-6)).clamp(max=1.0)
        for gradient in gradients:
            gradient.mul_(scale.view(-1, *[1] * (gradient.dim() - 1)))
    return total


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
