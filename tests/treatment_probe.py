"""Can the condition be read from features? A classifier fitted anew, while the features stay."""

import torch
from torch import nn
from torch.nn import functional

from animarl_algos.losses.values import mean_recall, treatment_counts
from animarl_algos.networks.networks import TREATMENT_UNITS

SMALLEST_SCALE = 1e-3
"""Units that vary by less are not blown up to unit variance."""


def probe_balanced_accuracy(
    train: tuple[torch.Tensor, torch.Tensor],
    test: tuple[torch.Tensor, torch.Tensor],
    *,
    updates: int = 300,
    seed: int = 0,
) -> float:
    """Balanced accuracy on ``test`` of a probe fitted to ``train``; 0.5 is chance.

    The probe is a treatment head (two layers, 8 units) on standardised features, fitted by Adam to
    the whole training set at once, without an opponent. Both sets are features ``(N, H)`` and
    conditions ``(N,)``.
    """
    features, condition = train
    centre, scale = features.mean(0), features.std(0).clamp(min=SMALLEST_SCALE)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        probe = nn.Sequential(
            nn.Linear(features.shape[1], TREATMENT_UNITS), nn.ReLU(), nn.Linear(TREATMENT_UNITS, 1)
        )
    optimizer = torch.optim.Adam(probe.parameters(), lr=1e-2)
    share = condition.float().mean().item()
    weight = torch.where(condition > 0, 0.5 / share, 0.5 / (1.0 - share))  # as balanced accuracy
    for _ in range(updates):
        logits = probe((features - centre) / scale)[:, 0]
        loss = functional.binary_cross_entropy_with_logits(logits, condition.float(), weight)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    features, condition = test
    with torch.no_grad():
        logits = probe((features - centre) / scale)[:, 0].view(1, 1, -1)
    everywhere = torch.ones_like(logits, dtype=torch.bool)
    return float(mean_recall(treatment_counts(logits, condition.view(1, -1), everywhere)))


def share_of_variance(features: torch.Tensor, condition: torch.Tensor) -> float:
    """How much of the variance of features ``(N, H)`` lies between the means of the conditions."""
    treated, other = features[condition > 0], features[condition <= 0]
    weight = len(treated) * len(other) / len(features) ** 2
    between = weight * (treated.mean(0) - other.mean(0)).square().sum()
    total = features.var(0, correction=0).sum()
    return float(between / total) if total > 0 else 0.0
