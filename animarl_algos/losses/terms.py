"""What learners minimise: loss terms, the weights of a phase, and recipes made of terms.

A term (paper, "Offline and online policy learning") looks at :class:`MinibatchValues`, the
networks' view of a minibatch of sequences, and gives one number per individual, averaged over its
valid steps. A recipe's loss is the sum of its terms, each with its weight of the phase (offline or
online). A new weight is named in :class:`Phase` and among the settings of learners, and has its
value in ``animarl_algos/learner/settings.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import ClassVar, Protocol

import torch
from torch.nn import functional

from animarl_algos.losses.losses import (
    action_cross_entropy,
    masked_mean,
    soft_action_cross_entropy,
    squared_l2,
    treatment_cross_entropy,
)
from animarl_algos.losses.values import ValueDistribution, n_step_target
from animarl_algos.replay.store import SequenceBatch
from animarl_envs.errors import InputError


@dataclass(frozen=True)
class Phase:
    """The numbers of one phase of training.

    Attributes
    ----------
    name
        ``"offline"`` or ``"online"``, for messages and logs.
    gamma
        Discount per step.
    alpha
        Weight of the distance penalty in the reward, ``R - alpha * penalty``.
    lambda1, lambda2, lambda3
        Weights of squared l2 norm, treatment cross-entropy and action supervision.
    max_grad_norm
        Largest gradient norm of one individual; ``None`` does not clip.
    scaled_penalties
        Whether penalties of all actions are taken in units of their mean over actions and steps
        (per individual and batch) instead of arena units. That mean is about ``u dt^2``, how far
        one thrust moves the animal in a step: 0.03 for the agents and 0.0001 for the newts.
    n_steps
        Rewards that are summed before the value of what follows (Sutton 1988; Hessel et al. 2018).
    """

    name: str
    gamma: float
    alpha: float
    lambda1: float
    lambda2: float
    lambda3: float
    max_grad_norm: float | None
    scaled_penalties: bool = False
    n_steps: int = 1


WEIGHTS = tuple(
    each.name
    for each in fields(Phase)
    if each.name not in ("name", "gamma", "max_grad_norm", "scaled_penalties", "n_steps")
)


class ActionValues(Protocol):
    """Action values of the T + 1 states of T steps, as a network's output has them."""

    @property
    def values(self) -> torch.Tensor:
        """``(K, T + 1, B, A, Q)``."""
        ...

    @property
    def q_values(self) -> torch.Tensor:
        """``(K, T + 1, B, A)``, their mean over the quantiles."""
        ...

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """``(K, T + 1, B, Q)``, the values of the actions ``(K, T + 1, B)``."""
        ...


@dataclass
class MinibatchValues:
    """Outputs of the networks for a batch, from its first trained step on.

    Axes (individual K, time T, batch B, action A, quantile Q).

    Attributes
    ----------
    batch
        Its leading ``burn_in`` steps already cut off.
    valid
        ``(K, T, B)`` bool, the steps that enter a loss.
    online, target
        Both networks at all states, the last included; no ``target`` if no term asks for it, and
        then the last states may be left out too.
    treatment_logits
        ``(K, T, B)``, or ``None`` without a treatment head.
    parameters, shared
        The online network's, each ``(K, ...)``; those of them that all individuals have in common.
    errors
        ``(K, T, B)``, set by the temporal-difference terms: absolute errors, for priorities.
    demonstrated
        The same of demonstrated steps, beside the learner's own, where a recipe is ``inverse``.
    """

    batch: SequenceBatch
    phase: Phase
    distribution: ValueDistribution
    valid: torch.Tensor
    online: ActionValues
    target: ActionValues | None
    treatment_logits: torch.Tensor | None
    parameters: Sequence[torch.Tensor]
    shared: Sequence[torch.Tensor] = ()
    errors: torch.Tensor | None = field(default=None)
    demonstrated: MinibatchValues | None = field(default=None)

    @property
    def values(self) -> torch.Tensor:
        """``(K, T, B, A, Q)``, the online network before each step."""
        return self.online.values[:, : self.batch.num_steps]

    @property
    def q_values(self) -> torch.Tensor:
        """``(K, T, B, A)``, expected values before each step."""
        return self.online.q_values[:, : self.batch.num_steps]

    def taken_values(self) -> torch.Tensor:
        """``(K, T, B, Q)``, the online network's values of the actions taken."""
        with_last = functional.pad(self.batch.actions, (0, 0, 0, 1))  # none is taken there
        return self.online.of_actions(with_last)[:, :-1]

    def double_q_target(self, rewards: torch.Tensor) -> torch.Tensor:
        """``R + gamma Q_target(s', argmax_a Q(s', a))``, ``(K, T, B, Q)``.

        With ``n_steps`` of the phase that many rewards come before the value, as far as the
        sequence goes on: at its end fewer.
        """
        assert self.target is not None
        best = self.online.q_values.detach().argmax(-1)  # ties: the lowest index
        bootstrap = self.target.of_actions(best)[:, 1:]
        over, phase = self.batch.terminated > 0, self.phase
        return n_step_target(
            rewards, over, bootstrap, self.batch, gamma=phase.gamma, n_steps=phase.n_steps
        )


@dataclass(frozen=True)
class LossTerm:
    """One summand of a recipe's loss.

    Attributes
    ----------
    name
        Under which it is logged.
    needs_target
        Whether it bootstraps from the target network.
    """

    name: ClassVar[str]
    needs_target: ClassVar[bool] = False

    def weight(self, phase: Phase) -> float:
        """Return its factor in the sum."""
        return 1.0

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return ``(K,)``, one number per individual."""
        raise NotImplementedError


@dataclass(frozen=True)
class TemporalDifference(LossTerm):
    """``J_DQ``: one-step double-Q loss of the action taken, with reward ``R - alpha * penalty``.

    ``shaped=False`` leaves the distance penalty out (DQN, DQAAS).
    """

    shaped: bool = False
    name: ClassVar[str] = "td"
    needs_target: ClassVar[bool] = True

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        batch, rewards = minibatch.batch, minibatch.batch.rewards
        if self.shaped:
            rewards = rewards - minibatch.phase.alpha * batch.penalties
        target = minibatch.double_q_target(rewards)
        td = minibatch.distribution.td_loss(minibatch.taken_values(), target)
        minibatch.errors = td.error
        return masked_mean(td.loss, minibatch.valid, batch.weights)


@dataclass(frozen=True)
class ScoredActionsTemporalDifference(LossTerm):
    """Offline ``J_DQ`` of DQDIL: all actions of a demonstrated state, each with its own penalty.

    From state s_t the fitted dynamics predicts where each action would lead; its distance to the
    next demonstrated position is that action's penalty p(t, a). Every action value is regressed
    towards::

        Q(s_t, a) -> R_t - alpha p(t, a) + gamma Q_target(s_{t+1}, argmax_a' Q(s_{t+1}, a'))

    with s_{t+1} the demonstrated successor: the penalty says by how much an action misses it, and
    after one step nothing else is known about where it would have led. The targets of a state then
    differ by -alpha p(t, a) alone, so the values rank the actions as the distances do and the
    demonstrated action, being closest, comes first. (Scoring the demonstrated action only would
    lower it against the twelve others, which nothing else touches.)

    With ``scaled_penalties`` of the phase, p is divided by its mean over actions and steps. In
    arena units the differences between actions shrink with the animals' thrust, until the noise of
    the common target drowns them; scaled, alpha weighs imitation alike for every species.
    """

    name: ClassVar[str] = "td"
    needs_target: ClassVar[bool] = True

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        batch = minibatch.batch
        if batch.action_penalties is None:
            raise InputError(
                "the demonstrations carry no penalties of all actions: "
                "make the dataset with the fitted dynamics of their species"
            )
        penalty = minibatch.phase.alpha * batch.action_penalties
        if minibatch.phase.scaled_penalties:
            unit = masked_mean(batch.action_penalties.mean(-1), minibatch.valid)
            penalty = penalty / unit.clamp(min=1e-12).view(-1, 1, 1, 1)
        # Valid steps only: there are 13 values to each.
        valid = minibatch.valid
        target = minibatch.double_q_target(batch.rewards)[valid].unsqueeze(-2)
        td = minibatch.distribution.td_loss(
            minibatch.values[valid], target - penalty[valid].unsqueeze(-1)
        )
        minibatch.errors = _padded(td.error.mean(-1), valid)
        return masked_mean(_padded(td.loss.mean(-1), valid), valid, batch.weights)


def _padded(per_valid_step: torch.Tensor, valid: torch.Tensor) -> torch.Tensor:
    """(N,) values of the valid steps back in their places, (K, T, B), zero elsewhere."""
    padded = per_valid_step.new_zeros(valid.shape)
    return padded.masked_scatter(valid, per_valid_step)


@dataclass(frozen=True)
class ActionSupervision(LossTerm):
    """``J_AS``: cross-entropy with the demonstrated action, action values as logits.

    Online the label is the demonstrated action that dynamic time warping aligns with the rollout's
    step (DQAAS); offline it is the demonstrated action of the step itself. ``weighted=False`` takes
    it as it is (BC, whose only data term it is), otherwise times lambda3.
    """

    weighted: bool = True
    name: ClassVar[str] = "supervision"

    def weight(self, phase: Phase) -> float:
        return phase.lambda3 if self.weighted else 1.0

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        batch = minibatch.batch
        return action_cross_entropy(
            minibatch.q_values, batch.labels, minibatch.valid, batch.weights
        )


@dataclass(frozen=True)
class SoftActionSupervision(LossTerm):
    """Cross-entropy with soft labels, action values as logits.

    The label of a step is a distribution over the actions: how near each would have led under the
    fitted dynamics (:func:`animarl_algos.data.species_data.soft_labels`). Of two actions which both
    explain the track none is then called wrong, as in learning from label distributions (Geng 2016)
    and in distillation (Hinton et al. 2015). Demonstrations without soft labels have it all on the
    demonstrated action: plain cloning.
    """

    name: ClassVar[str] = "supervision"

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        batch = minibatch.batch
        if batch.label_shares is None:
            return action_cross_entropy(
                minibatch.q_values, batch.labels, minibatch.valid, batch.weights
            )
        return soft_action_cross_entropy(
            minibatch.q_values, batch.label_shares, minibatch.valid, batch.weights
        )


@dataclass(frozen=True)
class TreatmentAdversary(LossTerm):
    """``J_tr``: cross-entropy of the condition, predicted from h_t through gradient reversal."""

    name: ClassVar[str] = "treatment"

    def weight(self, phase: Phase) -> float:
        return phase.lambda2

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        assert minibatch.treatment_logits is not None
        batch = minibatch.batch
        return treatment_cross_entropy(
            minibatch.treatment_logits, batch.condition, minibatch.valid, batch.weights
        )


@dataclass(frozen=True)
class WeightDecay(LossTerm):
    """``J_l2``: squared norm of all weights of the individual's network.

    Its value carries no gradient: :func:`animarl_algos.learner.updates.update` adds that in
    closed form.
    """

    name: ClassVar[str] = "l2"

    def weight(self, phase: Phase) -> float:
        return phase.lambda1

    @torch.no_grad()
    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        return squared_l2(minibatch.parameters)


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
class InverseSoftQ(LossTerm):
    """The loss above. A demonstrated step with a soft label counts for each action by its share."""

    name: ClassVar[str] = "iq"

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


class Selection(StrEnum):
    """Validation figure (the lower the better) by which the best offline epoch is kept."""

    CROSS_ENTROPY = "cross_entropy"  # of the demonstrated action, values as logits [nat]
    LABEL_CROSS_ENTROPY = "label_cross_entropy"  # of the labels learned from, soft ones too [nat]
    MEAN_RANK = "mean_rank"  # of the demonstrated action's value among all actions, best 1


class OfflineLoss(StrEnum):
    """Loss of the offline phase."""

    RECIPE = "recipe"  # the recipe's own terms (the paper)
    CLONING = "cloning"  # cross-entropy of soft labels


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The loss terms of a learner (paper, "Baseline methods").

    Attributes
    ----------
    name
        As on the command line, without the prefix ``qr-``.
    online, offline
        Terms of the two phases; empty where a recipe has no such phase.
    selection
        How its best offline epoch is chosen.
    needs_distance
        Whether the environment must hand out ``dtw_penalty``.
    needs_alignment
        Whether it must hand out ``aligned_action``.
    needs_condition
        Whether the last observation component must be the condition flag (treatment head).
    inverse
        Whether the online phase learns from demonstrated steps beside its own, action values being
        the logits of the policy: it acts by ``softmax Q`` at temperature 1.
    """

    name: str
    online: tuple[LossTerm, ...] = ()
    offline: tuple[LossTerm, ...] = ()
    selection: Selection = Selection.MEAN_RANK
    needs_distance: bool = False
    needs_alignment: bool = False
    needs_condition: bool = False
    inverse: bool = False

    def cloning(self) -> Recipe:
        """Return this recipe with an offline phase that clones and keeps only its adversary.

        Values regressed towards penalties would be soft labels too, of an arbitrary scale.
        """
        kept = (term for term in self.offline if isinstance(term, TreatmentAdversary))
        return replace(
            self,
            offline=(SoftActionSupervision(), *kept),
            selection=Selection.LABEL_CROSS_ENTROPY,
        )
