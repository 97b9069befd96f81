"""What is learned about an action: its expected return (DQN) or the return's quantiles (QR-DQN).

This is the only difference between the two families of learners. Below it stand the means of losses
per individual, the gradient reversal layer, and clipping per individual. A loss is averaged over
the valid steps of the individual itself, so that summing the losses of all individuals gives each
the gradient it would have if trained alone.

Axes are (individual K, time T, batch B). Losses take ``valid`` ``(K, T, B)`` bool, False on padded,
burnt-in and warm-up steps, and maybe ``weights`` ``(K, B)``, importance-sampling weights; they
return ``(K,)``, 0 for an individual without valid steps.
"""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from animarl_envs.compiling import jit


def quantile_huber(current: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the quantile Huber loss with threshold 1, per step.

    Dabney et al. 2018, equations 9 and 10::

        sum over i, mean over j of |tau_i - 1(delta_ij < 0)| huber(delta_ij)
        delta_ij = target_j - current_i,  tau_i = (i + 1/2) / quantiles

    ``current`` is ``(..., quantiles)``; ``target`` ``(..., target quantiles)`` gets no gradient.
    """
    if not current.is_cpu:
        return quantile_huber_definition(current, target.detach())
    loss: torch.Tensor = _QuantileHuber.apply(current, target)  # type: ignore[no-untyped-call]
    return loss


def quantile_huber_definition(current: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return :func:`quantile_huber` by tensor operations, term by term."""
    quantiles = current.shape[-1]
    tau = (torch.arange(quantiles, device=current.device, dtype=current.dtype) + 0.5) / quantiles
    delta = target.unsqueeze(-2) - current.unsqueeze(-1)
    # |tau - 1(delta < 0)| is tau above and 1 - tau below.
    weight = torch.where(delta.detach() < 0, (1 - tau).unsqueeze(-1), tau.unsqueeze(-1))
    huber = functional.huber_loss(delta, torch.zeros_like(delta), reduction="none")
    return (weight * huber).sum(-2).mean(-1)


class _QuantileHuber(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, current: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        quantiles = current.shape[-1]
        rows = _rows(current)
        tau = (np.arange(quantiles) + 0.5) / quantiles
        loss = np.empty(len(rows), dtype=rows.dtype)
        gradient = np.empty_like(rows)
        _loss_and_gradient(rows, _rows(target), tau.astype(rows.dtype), loss, gradient)
        ctx.save_for_backward(torch.from_numpy(gradient).view(current.shape))
        return torch.from_numpy(loss).view(current.shape[:-1])

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * grad_outputs[0].unsqueeze(-1), None


def _rows(tensor: torch.Tensor) -> NDArray[Any]:
    rows: NDArray[Any] = tensor.detach().reshape(-1, tensor.shape[-1]).contiguous().numpy()
    return rows


@jit(fastmath={"contract", "nsz"})
def _loss_and_gradient(current, target, tau, loss, gradient):  # type: ignore[no-untyped-def]
    """Fill ``loss`` (N,) and its derivative ``gradient`` (N, Q) by ``current`` (N, Q)."""
    quantiles = current.shape[1]
    one = tau.dtype.type(1.0)
    half = tau.dtype.type(0.5)
    share = one / tau.dtype.type(target.shape[1])
    summed = np.empty(quantiles, dtype=tau.dtype)
    slopes = np.empty(quantiles, dtype=tau.dtype)
    for n in range(len(current)):
        row = current[n]
        summed[:] = 0.0
        slopes[:] = 0.0
        for j in range(target.shape[1]):
            aim = target[n, j]
            for i in range(quantiles):
                delta = aim - row[i]
                slope = delta  # of the Huber function, which is slope (delta - slope / 2)
                slope = one if delta > one else slope
                slope = -one if delta < -one else slope
                weighted = slope * (one - tau[i] if delta < 0 else tau[i])
                summed[i] += weighted * (delta - half * slope)
                slopes[i] += weighted
        total = tau.dtype.type(0.0)
        for i in range(quantiles):
            total += summed[i]
            gradient[n, i] = -slopes[i] * share
        loss[n] = total * share


def take_action(values: torch.Tensor, actions: torch.Tensor) -> torch.Tensor:
    """Pick one action's outputs: (..., actions, quantiles) and (...) to (..., quantiles)."""
    if values.shape[-1] == 1:
        return values.squeeze(-1).gather(-1, actions.unsqueeze(-1))
    index = actions[..., None, None].expand(*actions.shape, 1, values.shape[-1])
    return values.gather(-2, index).squeeze(-2)


@dataclass(frozen=True)
class ValueDistribution:
    """What is learned about an action."""

    # Quantiles of the return (Dabney et al. 2018), 2 or more; None: its expected value.
    n_quantiles: int | None = None
    # Of an expected value's error: squared (the paper's), or Huber's with threshold 1
    # (stable-baselines3's); quantiles have their own, :func:`quantile_huber`.
    loss: Literal["squared", "huber"] = "squared"

    def td_loss(
        self, value: torch.Tensor, target: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return loss and size of the temporal-difference error, both (...), the size detached.

        ``value`` and ``target`` are ``(..., quantiles)``, or ``(..., 1)``, of the action that was
        taken.
        """
        if self.n_quantiles is not None:
            error = (target.mean(-1) - value.mean(-1)).detach().abs()
            return quantile_huber(value, target), error
        error = (target - value).squeeze(-1)
        if self.loss == "squared":
            return error.square(), error.detach().abs()
        loss = functional.smooth_l1_loss(error, torch.zeros_like(error), reduction="none")
        return loss, error.detach().abs()


@contextmanager
def denormals_as_zero() -> Iterator[None]:
    """Take numbers nearer to zero than 1e-38 for zero meanwhile, in this thread.

    Gradients through many steps have many such, and a processor multiplies them far more slowly.
    """
    already = not (torch.full((1,), 1e-39) * 1.0).item()
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(already)


def masked_mean(
    per_step: torch.Tensor, valid: torch.Tensor, weights: torch.Tensor | None = None
) -> torch.Tensor:
    """Mean of ``per_step`` (K, T, B) over each individual's valid steps.

    Whatever stands on other steps leaves the mean alone; its gradient is zero, provided that what
    the loss was made of there is finite. Weights scale the loss and not the divisor, which stays
    the number of valid steps.
    """
    kept = torch.where(valid, per_step, 0.0)
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
