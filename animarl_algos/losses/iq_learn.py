"""IQ-Learn: inverse soft Q-learning (Garg et al. 2021, "IQ-Learn", equation 10 and section 5.3).

Action values Q define a policy, ``softmax Q`` at temperature 1, its soft value
``V(s) = log sum_a exp Q(s, a)``, and the reward under which that policy is optimal::

    r(s, a) = Q(s, a) - gamma V(s')

What is minimised, over Q, is the worth of the reward to the policy minus its worth to the
demonstrations, with a chi-squared regularisation of the reward::

    -E_demo[r] + E_both[V(s) - gamma V(s')] + 1/2 E_both[r^2]

where "both" are demonstrated steps and the policy's own, half and half. Where an episode ends,
V(s') is not the network's: an end that the task punishes (out of the arena) is worth 0, as all ends
are in the authors' code; any other as much as the demonstrated states are on average, so that
contact is neither sought nor avoided for its own sake.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional

from animarl_algos.losses.losses import masked_mean
from animarl_algos.losses.phase import Phase
from animarl_algos.losses.terms import MinibatchValues


def soft_value(q_values: torch.Tensor) -> torch.Tensor:
    """``log sum_a exp Q``: (..., actions) to (...)."""
    return q_values.logsumexp(-1)


def next_values(minibatch: MinibatchValues, end_value: torch.Tensor) -> torch.Tensor:
    """``V(s')``, (K, T, B); ``end_value`` (K,) after an end that the task does not punish."""
    batch = minibatch.batch
    after = soft_value(minibatch.online.q_values[:, 1:])
    at_end = torch.where(batch.rewards < 0, 0.0, end_value.view(-1, 1, 1))
    return torch.where(batch.terminated > 0, at_end, after)


@dataclass(frozen=True)
class InverseSoftQ:
    """The loss above. A demonstrated step with a soft label counts for each action by its share."""

    name: str = "iq"
    needs_target: bool = False

    def weight(self, phase: Phase) -> float:
        return 1.0

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        shown = minibatch.demonstrated
        assert shown is not None
        end_value = masked_mean(soft_value(shown.q_values), shown.valid).detach()
        loss = torch.zeros_like(end_value)
        for steps in (shown, minibatch):
            shares = steps.batch.label_shares
            if shares is None:
                shares = functional.one_hot(steps.batch.actions, steps.q_values.shape[-1])
            following = minibatch.phase.gamma * next_values(steps, end_value)
            rewards = steps.q_values - following.unsqueeze(-1)
            worth = soft_value(steps.q_values) - following
            squares = 0.5 * (shares * rewards.square()).sum(-1)
            loss = loss + 0.5 * masked_mean(worth + squares, steps.valid)
            if steps is shown:
                loss = loss - masked_mean((shares * rewards).sum(-1), steps.valid)
        return loss
