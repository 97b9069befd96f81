"""IQ-Learn: inverse soft Q-learning (Garg et al. 2021, "IQ-Learn", equation 10 and section 5.3).

Action values Q define a policy, ``softmax Q`` at temperature 1, its soft value
``V(s) = log sum_a exp Q(s, a)``, and the reward under which that policy is optimal::

    r(s, a) = Q(s, a) - gamma V(s')

What is minimised, over Q, is the worth of the reward to the policy minus its worth to the
demonstrations, with a chi-squared regularisation of the reward::

    -E_demo[r] + E_demo+own[V(s) - gamma V(s')] + 1/2 E_demo+own[r^2]

where "own" are rows that the policy collected itself. An episode that ended stays for ever in a
state whose value is given, the same for demonstrations and own episodes: ending as the
demonstrations do is worth something, leaving the arena is not.

Axes: (individual, row, action); terms are means over rows, one number per individual.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch


def soft_value(q_values: torch.Tensor) -> torch.Tensor:
    """``log sum_a exp Q``: (..., actions) to (...)."""
    return q_values.logsumexp(-1)


def value_after(next_q_values: torch.Tensor, absorbed: torch.Tensor) -> torch.Tensor:
    """``V(s')``.

    Parameters
    ----------
    next_q_values : Tensor (..., actions)
    absorbed : Tensor (...)
        The value of the state in which an ended episode stays; NaN where it goes on.
    """
    goes_on = absorbed.isnan()
    return torch.where(goes_on, soft_value(next_q_values), absorbed)


@dataclass(frozen=True)
class ImpliedRewards:
    """What action values say about rows of demonstrations and of the policy's own.

    Attributes
    ----------
    q_values : Tensor (K, rows, actions)
        Before the step.
    actions : Tensor (K, rows) int64
        Taken in it.
    next_value : Tensor (K, rows)
        ``V(s')``, from :func:`value_after`, with its gradient.
    demonstrated : Tensor (rows,) bool
        Whose row it is; some must be demonstrated.
    gamma
        Discount per step.
    """

    q_values: torch.Tensor
    actions: torch.Tensor
    next_value: torch.Tensor
    demonstrated: torch.Tensor
    gamma: float

    @property
    def reward(self) -> torch.Tensor:
        """``r = Q(s, a) - gamma V(s')``, (K, rows)."""
        taken = self.q_values.gather(-1, self.actions.unsqueeze(-1)).squeeze(-1)
        return taken - self.gamma * self.next_value

    def demonstrated_reward(self) -> torch.Tensor:
        """``-E_demo[r]``, (K,)."""
        return -self.reward[:, self.demonstrated].mean(1)

    def policy_worth(self) -> torch.Tensor:
        """``E[V(s) - gamma V(s')]`` over all rows, (K,): telescopes to the value of the starts."""
        return (soft_value(self.q_values) - self.gamma * self.next_value).mean(1)

    def squared_reward(self) -> torch.Tensor:
        """``1/2 E[r^2]`` over all rows, (K,)."""
        return 0.5 * self.reward.square().mean(1)

    def loss(self) -> torch.Tensor:
        """The sum of the three, (K,)."""
        return self.demonstrated_reward() + self.policy_worth() + self.squared_reward()
