"""Learners of :class:`toys.Confounded`: their settings, and what they make of the condition.

Below: can the condition be read from features? A classifier fitted anew, while the features stay.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import toys
from stable_baselines3.common.utils import LinearSchedule
from torch import nn
from torch.nn import functional

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.losses.values import mean_recall, treatment_counts
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.networks import TREATMENT_UNITS

SETTINGS: dict[str, Any] = {
    "learning_rate": 3e-3, "gamma": 0.0, "lambda1": 3e-4, "lambda2": 0.3, "buffer_size": 5000,
    "target_update_interval": (100, "episode"), "updates_per_episode": 0.8,
    "exploration_initial_eps": 1.0, "exploration_final_eps": 0.5, "exploration_steps": 4000,
    "device": "cpu",
}  # fmt: skip
NO_MOMENTUM = {"policy_kwargs": {"optimizer_kwargs": {"betas": (0.0, 0.9)}}}
SETTLED = NO_MOMENTUM | {"learning_rate": LinearSchedule(SETTINGS["learning_rate"], 0.0, 1.0)}
"""Under which the treatment head and the encoder stop chasing each other."""


@dataclass(frozen=True)
class Reading:
    """Memory ``(1, T, B, H)``, treatment logits ``(1, T, B)`` and condition ``(1, B)``."""

    hidden: torch.Tensor
    logits: torch.Tensor | None
    condition: torch.Tensor

    def rows(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Features ``(N, H)`` and conditions ``(N,)`` of all steps."""
        features = self.hidden.flatten(0, 2)
        return features, self.condition.expand(self.hidden.shape[1], -1).flatten()

    def head_accuracy(self) -> float:
        """Balanced accuracy of the treatment head; 0.5 is chance."""
        assert self.logits is not None
        everywhere = torch.ones_like(self.logits, dtype=torch.bool)
        return float(mean_recall(treatment_counts(self.logits, self.condition, everywhere)))

    def head_cross_entropy(self) -> float:
        """Of the treatment head [nat]; chance is log 2."""
        assert self.logits is not None
        condition = self.condition.unsqueeze(1).expand_as(self.logits).to(self.logits.dtype)
        return float(functional.binary_cross_entropy_with_logits(self.logits, condition))


def read_condition(model: SequenceQLearning, seed: int, copies: int = 512) -> Reading:
    """Fresh episodes, acted with epsilon one half, as the online network sees them."""
    env, state = toys.Confounded(copies, seed=seed), None
    observation = env.reset()
    condition = torch.tensor(env.condition).unsqueeze(0)
    previous = np.full(copies, model.policy.num_actions)
    observed, done_before = [], []
    model.policy.acting = Acting.epsilon_greedy(0.5)
    for _ in range(env.time_limit):
        observed.append(observation.copy())
        done_before.append(previous.copy())
        previous, state = model.predict(observation, state)
        observation, *_ = env.step(previous)
    stacked, actions = np.stack(observed)[None], np.stack(done_before)[None]
    with torch.no_grad():
        output = model.policy.q_net(torch.tensor(stacked), torch.tensor(actions))
        return Reading(output.hidden, output.treatment_logits, condition)


def flip_behaviour(model: SequenceQLearning) -> tuple[float, float]:
    """Share of right actions under the actual flag, and of those that follow a flipped one."""
    env = toys.Confounded(64, seed=9)
    observation = env.reset()
    flipped = observation.copy()
    flipped[:, -1] = 1.0 - flipped[:, -1]
    factual, _ = model.predict(observation, deterministic=True)
    counterfactual, _ = model.predict(flipped, deterministic=True)
    right = (factual == env.condition).mean()
    return float(right), float((counterfactual == 1 - env.condition).mean())


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
