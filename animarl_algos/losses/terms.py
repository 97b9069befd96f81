"""What learners minimise: loss terms, the weights of a phase, and recipes made of terms.

A term (paper, "Offline and online policy learning") looks at :class:`MinibatchValues`, the
networks' view of a minibatch of sequences, and gives one number per individual, averaged over its
valid steps. A recipe's loss is the sum of its terms, each with its weight of the phase (offline or
online). A new weight is named in :class:`Phase` and among the settings of learners, and has its
value in ``animarl_algos/learner/settings.py``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar

import torch
from torch.nn import functional

from animarl_algos.losses.values import ValueDistribution, masked_mean
from animarl_algos.replay.store import NO_LABEL, SequenceBatch


@dataclass(frozen=True)
class Phase:
    """The numbers of one phase of training; see the settings of the same names.

    Attributes
    ----------
    name
        ``"offline"`` or ``"online"``, for messages and logs.
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


@dataclass
class MinibatchValues:
    """Outputs of the networks for a batch, from its first trained step on.

    Axes (individual K, time T, batch B, action A, quantile Q).

    ``online`` and ``target`` are what both networks say of all states, the last included
    (:class:`animarl_algos.networks.networks.QOutput`); there is no ``target`` if no term asks for
    it, and then the last states may be left out too. Of single steps without a memory, ``online``
    has the states before them, ``successors`` (of the online network, without gradient) and
    ``target`` those after them.
    """

    batch: SequenceBatch  # its leading burn_in steps already cut off
    phase: Phase
    distribution: ValueDistribution
    valid: torch.Tensor  # (K, T, B) bool, the steps that enter a loss
    online: Any
    target: Any
    treatment_logits: torch.Tensor | None  # (K, T, B); None without a treatment head
    parameters: Sequence[torch.Tensor]  # the online network's, each (K, ...)
    successors: Any = None
    shared: Sequence[torch.Tensor] = ()  # those of them that all individuals have in common
    total: float = 0.0  # weighted sum of all terms but weight decay, set by an update
    errors: torch.Tensor | None = None  # (K, T, B), absolute, set by temporal differences

    @property
    def values(self) -> torch.Tensor:
        """``(K, T, B, A, Q)``, the online network before each step."""
        values: torch.Tensor = self.online.values[:, : self.batch.num_steps]
        return values

    @property
    def q_values(self) -> torch.Tensor:
        """``(K, T, B, A)``, expected values before each step."""
        q_values: torch.Tensor = self.online.q_values[:, : self.batch.num_steps]
        return q_values

    def double_q_target(self, rewards: torch.Tensor) -> torch.Tensor:
        """``R + gamma Q_target(s', argmax_a Q(s', a))``, ``(K, T, B, Q)``, without gradient.

        The double-Q target of van Hasselt et al. 2016 (the paper, equation "ddqn"), without the
        second term where s' is terminal; a time-out is not terminal. With ``n_steps`` of the phase
        that many rewards come before the value, as far as the sequence goes on: at its end fewer.
        """
        batch, phase = self.batch, self.phase
        best = (self.successors or self.online).q_values.detach().argmax(-1)  # ties: the lowest
        bootstrap = self.target.of_actions(best)  # without gradient, as all of the target
        if self.successors is None:
            bootstrap = bootstrap[:, 1:]
        discount = (phase.gamma * (1.0 - batch.terminated)).unsqueeze(-1)
        rewards = rewards.unsqueeze(-1)
        target: torch.Tensor = rewards + discount * bootstrap
        if phase.n_steps > 1:
            steps = torch.arange(1, batch.num_steps + 1, device=rewards.device)
            within = (steps.view(1, -1, 1) < batch.lengths.unsqueeze(1)).unsqueeze(-1)
            for _ in range(phase.n_steps - 1):
                later = torch.cat((target[:, 1:], target[:, -1:]), dim=1)
                target = rewards + discount * torch.where(within, later, bootstrap)
        return target


@dataclass(frozen=True)
class LossTerm(ABC):
    """One summand of a recipe's loss.

    Attributes
    ----------
    name
        Under which it is logged.
    weighed_by
        The weight of the phase that is its factor in the sum; None: 1.
    needs_target
        Whether it bootstraps from the target network.
    """

    name: ClassVar[str]
    weighed_by: ClassVar[str | None] = None
    needs_target: ClassVar[bool] = False

    def weight(self, phase: Phase) -> float:
        """Return its factor in the sum."""
        return 1.0 if self.weighed_by is None else float(getattr(phase, self.weighed_by))

    @abstractmethod
    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return ``(K,)``, one number per individual."""


@dataclass(frozen=True)
class TemporalDifference(LossTerm):
    """``J_DQ``: double-Q loss of the action taken, with reward ``R - alpha * penalty``.

    ``shaped=False`` leaves the distance penalty out (DQN, DQAAS).
    """

    shaped: bool = False
    name: ClassVar[str] = "td"
    needs_target: ClassVar[bool] = True

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return the loss of each individual, ``(K,)``."""
        batch, rewards = minibatch.batch, minibatch.batch.rewards
        if self.shaped:
            rewards = rewards - minibatch.phase.alpha * batch.penalties
        target = minibatch.double_q_target(rewards)
        td_loss = minibatch.distribution.td_loss
        if minibatch.successors is None:
            with_last = functional.pad(batch.actions, (0, 0, 0, 1))  # none is taken there
            taken = minibatch.online.of_actions(with_last)[:, :-1]
        else:
            taken = minibatch.online.of_actions(batch.actions)
        loss, minibatch.errors = td_loss(taken, target)
        return masked_mean(loss, minibatch.valid, batch.weights)


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
        """Return the loss of each individual, ``(K,)``."""
        batch, valid = minibatch.batch, minibatch.valid
        assert batch.action_penalties is not None
        penalty = minibatch.phase.alpha * batch.action_penalties
        if minibatch.phase.scaled_penalties:
            unit = masked_mean(batch.action_penalties.mean(-1), valid)
            penalty = penalty / unit.clamp(min=1e-12).view(-1, 1, 1, 1)
        # Valid steps only: there are 13 values to each.
        target = minibatch.double_q_target(batch.rewards)[valid].unsqueeze(-2)
        loss, error = minibatch.distribution.td_loss(
            minibatch.values[valid], target - penalty[valid].unsqueeze(-1)
        )
        minibatch.errors = _padded(error.mean(-1), valid)
        return masked_mean(_padded(loss.mean(-1), valid), valid, batch.weights)


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

    ``soft=True`` takes soft labels where the demonstrations have any: a distribution over the
    actions, how near each would have led under the fitted dynamics
    (:func:`animarl_algos.data.species_data.soft_labels`). Of two actions which both explain the
    track none is then called wrong, as in learning from label distributions (Geng 2016) and in
    distillation (Hinton et al. 2015).
    """

    weighted: bool = True
    soft: bool = False
    name: ClassVar[str] = "supervision"

    def weight(self, phase: Phase) -> float:
        """Return lambda3, or 1 where the term is not weighted."""
        return phase.lambda3 if self.weighted else 1.0

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return the loss of each individual, ``(K,)``."""
        batch, target = minibatch.batch, minibatch.batch.label_shares if self.soft else None
        if target is None:
            target, labelled = batch.labels, batch.labels != NO_LABEL
        else:
            labelled = target.sum(-1) > 0  # steps with zeros alone are left out
        labelled = minibatch.valid & labelled
        per_step = functional.cross_entropy(
            minibatch.q_values[labelled], target[labelled], reduction="none"
        )
        return masked_mean(_padded(per_step, labelled), labelled, batch.weights)


@dataclass(frozen=True)
class TreatmentAdversary(LossTerm):
    """``J_tr``: cross-entropy of the condition, predicted from h_t through gradient reversal."""

    name: ClassVar[str] = "treatment"
    weighed_by: ClassVar[str | None] = "lambda2"

    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return the loss of each individual, ``(K,)``."""
        logits, batch = minibatch.treatment_logits, minibatch.batch
        assert logits is not None
        condition = batch.condition.unsqueeze(1).expand_as(logits).to(logits.dtype)
        per_step = functional.binary_cross_entropy_with_logits(logits, condition, reduction="none")
        return masked_mean(per_step, minibatch.valid, batch.weights)


@dataclass(frozen=True)
class WeightDecay(LossTerm):
    """``J_l2``: squared norm of all weights of the individual's network.

    Its value carries no gradient: :func:`animarl_algos.learner.updates.update` adds that in
    closed form.
    """

    name: ClassVar[str] = "l2"
    weighed_by: ClassVar[str | None] = "lambda1"

    @torch.no_grad()
    def __call__(self, minibatch: MinibatchValues) -> torch.Tensor:
        """Return the loss of each individual, ``(K,)``."""
        weights = torch.cat([p.flatten(1) for p in minibatch.parameters], dim=1)
        return weights.square().sum(1)


class Selection(StrEnum):
    """Validation figure (the lower the better) by which the best offline epoch is kept."""

    CROSS_ENTROPY = "cross_entropy"  # of the demonstrated action, values as logits [nat]
    LABEL_CROSS_ENTROPY = "label_cross_entropy"  # of the labels learned from, soft ones too [nat]
    MEAN_RANK = "mean_rank"  # of the demonstrated action's value among all actions, best 1


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
    needs_distance, needs_alignment
        Whether the environment must hand out ``dtw_penalty``, and ``aligned_action``.
    needs_condition
        Whether the last observation component must be the condition flag (treatment head).
    """

    name: str
    online: tuple[LossTerm, ...] = ()
    offline: tuple[LossTerm, ...] = ()
    selection: Selection = Selection.MEAN_RANK
    needs_distance: bool = False
    needs_alignment: bool = False
    needs_condition: bool = False

    def cloning(self) -> Recipe:
        """Return this recipe with an offline phase that clones and keeps only its adversary.

        Values regressed towards penalties would be soft labels too, of an arbitrary scale.
        """
        kept = (term for term in self.offline if isinstance(term, TreatmentAdversary))
        return replace(
            self,
            offline=(ActionSupervision(weighted=False, soft=True), *kept),
            selection=Selection.LABEL_CROSS_ENTROPY,
        )
