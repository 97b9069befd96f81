"""How a policy's action values fare on demonstrations it was not trained on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.updates import minibatch_values
from animarl_algos.losses.losses import mean_recall, treatment_counts
from animarl_algos.losses.terms import Phase
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy
from animarl_envs.errors import InputError

MOST_EPISODES = 16
"""Episodes evaluated together: minibatches of windows may be of hundreds, episodes are long."""
Figures = dict[str, float]


@dataclass(frozen=True)
class DemonstratedValues:
    """Action values at demonstrated states, one entry per individual.

    ``values`` ``(N, A)``, ``actions`` ``(N,)`` and soft labels ``shares`` ``(N, A)`` (None where
    there are none) over all valid, labelled steps; ``treatment_accuracy`` ``(K,)`` balanced, or
    None without a treatment head.
    """

    values: list[NDArray[np.float64]]
    actions: list[NDArray[np.int64]]
    shares: list[NDArray[np.float64] | None]
    treatment_accuracy: NDArray[np.float64] | None


@torch.no_grad()
def demonstrated_values(
    policy: GruPolicy,
    phase: Phase,
    dataset: OfflineDataset,
    batch_size: int,
    network: StackedQNetwork | None = None,
) -> DemonstratedValues:
    """Return the action values along demonstrated episodes: the policy's, or those of ``network``.

    Raises
    ------
    InputError
        If an individual has no demonstrated action.
    """
    count = len(policy.individuals)
    values: list[list[NDArray[np.float64]]] = [[] for _ in range(count)]
    actions: list[list[NDArray[np.int64]]] = [[] for _ in range(count)]
    shares: list[list[NDArray[np.float64]]] = [[] for _ in range(count)]
    counts: list[torch.Tensor] = []
    for batch in dataset.batches(min(batch_size, MOST_EPISODES)):
        minibatch = minibatch_values(
            policy, batch.to(policy.device), phase, needs_target=False, network=network
        )
        labels, soft = minibatch.batch.labels, minibatch.batch.label_shares
        shown = (minibatch.valid & (labels >= 0)).cpu().numpy()
        q_values = minibatch.q_values.double().cpu().numpy()
        for k in range(count):
            values[k].append(q_values[k][shown[k]])
            actions[k].append(labels[k].cpu().numpy()[shown[k]])
            if soft is not None:
                shares[k].append(soft[k].double().cpu().numpy()[shown[k]])
        if minibatch.treatment_logits is not None:
            counts.append(
                treatment_counts(
                    minibatch.treatment_logits, minibatch.batch.condition, minibatch.valid
                )
            )
    if not all(sum(map(len, each)) for each in actions):
        raise InputError(
            "the validation split holds no demonstrated action: split the data again, or infer the "
            "actions from the positions first"
        )
    accuracy = mean_recall(torch.stack(counts).sum(0)) if counts else None
    return DemonstratedValues(
        values=[np.concatenate(v) for v in values],
        actions=[np.concatenate(a) for a in actions],
        shares=[np.concatenate(s) if s else None for s in shares],
        treatment_accuracy=None if accuracy is None else accuracy.double().cpu().numpy(),
    )


def validation_figures(shown: DemonstratedValues, individuals: tuple[str, ...]) -> Figures:
    """Return how the demonstrated actions fare among all actions.

    ``val/cross_entropy`` [nat] with action values as logits, ``val/label_cross_entropy`` the same
    of the labels learned from (soft ones too) and ``val/cross_entropy_minus_marginal`` that minus
    the entropy of the labels' mean: what cloning without looking at the observation could reach,
    so that below 0 something is known. ``val/mean_rank`` (best 1; ties count half), ``val/top_1``
    and ``val/top_3`` (shares ranked first, among the first three), each as the mean over
    individuals and for each; with a treatment head ``val/treatment_balanced_accuracy``.
    """
    figures: dict[str, list[float]] = {
        "cross_entropy": [], "label_cross_entropy": [], "cross_entropy_minus_marginal": [],
        "mean_rank": [], "top_1": [], "top_3": [],
    }  # fmt: skip
    for values, actions, shares in zip(shown.values, shown.actions, shown.shares, strict=True):
        rank = demonstrated_rank(values, actions)
        log_norm = np.log(np.exp(values - values.max(1, keepdims=True)).sum(1)) + values.max(1)
        hard = float(np.mean(log_norm - values[np.arange(len(actions)), actions]))
        soft = hard if shares is None else float(np.mean(log_norm - (shares * values).sum(1)))
        marginal = marginal_entropy(actions, shares, values.shape[1])
        top = [float((rank <= n).mean()) for n in (1, 3)]
        found = (hard, soft, soft - marginal, float(rank.mean()), *top)
        for figure, value in zip(figures.values(), found, strict=True):
            figure.append(value)
    if shown.treatment_accuracy is not None:
        figures["treatment_balanced_accuracy"] = list(shown.treatment_accuracy)
    row: Figures = {}
    for name, per_individual in figures.items():
        row |= named_figures(f"val/{name}", individuals, np.array(per_individual))
    return row


def named_figures(name: str, individuals: tuple[str, ...], values: NDArray[np.floating]) -> Figures:
    """Return the mean over individuals, and where there are several each one's own."""
    row = {name: float(values.mean())}
    if len(values) > 1:
        row |= {f"{name}/{who}": float(v) for who, v in zip(individuals, values)}
    return row


def own_figures(row: Figures, name: str, individuals: tuple[str, ...]) -> list[float]:
    """Return each individual's own figure of :func:`named_figures`."""
    if len(individuals) == 1:
        return [row[name]]
    return [row[f"{name}/{who}"] for who in individuals]


def marginal_entropy(
    actions: NDArray[np.integer], shares: NDArray[np.floating] | None, num_actions: int
) -> float:
    """Return the entropy [nat] of the mean of ``actions`` (N,), or of soft ``shares`` (N, A)."""
    mean = np.bincount(actions, minlength=num_actions) / len(actions)
    if shares is not None:
        mean = shares.mean(0)
    present = mean[mean > 0]
    return float(-(present * np.log(present)).sum())


def demonstrated_rank(
    values: NDArray[np.floating], actions: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Return the rank of each demonstrated action among its state's values: 1 is the highest.

    Ties share their mean rank, so that indifference ranks as chance does. Among values that are not
    all finite there is no rank: NaN.
    """
    own = values[np.arange(len(actions)), actions][:, None]
    higher, equal = (values > own).sum(1), (values == own).sum(1)
    return np.where(np.isfinite(values).all(1), 1 + higher + (equal - 1) / 2, np.nan)
