"""What is learned about an action: its expected return (DQN) or the return's quantiles (QR-DQN).

This is the only difference between the two families of learners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from animarl_envs.compiling import jit


def quantile_huber(current: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Quantile Huber loss with threshold 1, per step (Dabney et al. 2018, equations 9 and 10)::

        sum over i, mean over j of |tau_i - 1(delta_ij < 0)| huber(delta_ij)
        delta_ij = target_j - current_i,  tau_i = (i + 1/2) / quantiles

    Parameters
    ----------
    current : Tensor (..., quantiles)
    target : Tensor (..., target quantiles)
        The leading axes are those of ``current``. It gets no gradient.

    Returns
    -------
    Tensor (...)
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
    index = actions[..., None, None].expand(*actions.shape, 1, values.shape[-1])
    return values.gather(-2, index).squeeze(-2)


@dataclass(frozen=True)
class ValueDistribution:
    """What is learned about an action.

    Parameters
    ----------
    n_quantiles
        Quantiles of the return per action (Dabney et al. 2018), 2 or more; None: its expected
        value.
    loss
        Of an expected value's error: squared (the paper's), or by Huber's with threshold 1
        (stable-baselines3's); quantiles have their own, :func:`quantile_huber`.
    """

    n_quantiles: int | None = None
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
