"""Learning from the replay memory: the updates, and the means of their losses for the log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import torch

from animarl_algos.learner.gradient_step import minibatch_values, update
from animarl_algos.losses.losses import mean_recall, treatment_counts
from animarl_algos.losses.terms import LossTerm, MinibatchValues, Phase
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.batch import SequenceBatch
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer


class Updater:
    """Updates of a policy's online network from sequences of the replay memory.

    Parameters
    ----------
    policy
        Whose networks and optimiser.
    terms
        Of the online loss.

    Attributes
    ----------
    losses
        Since the last :meth:`means`: the sum of each term ``(K,)``, and how many updates are in it.
    """

    def __init__(self, policy: GruPolicy, terms: Sequence[LossTerm]) -> None:
        self._policy, self._terms = policy, terms
        self._needs_target = any(term.needs_target for term in terms)
        self._start_averages()

    def _start_averages(self) -> None:
        self.losses: dict[str, tuple[torch.Tensor, int]] = {}
        shape = (len(self._policy.individuals), 2, 2)
        device = self._policy.device
        self._treatment_counts = torch.zeros(shape, dtype=torch.int64, device=device)

    def run(
        self,
        buffer: SequenceReplayBuffer,
        updates: int,
        batch_size: int,
        phase: Phase,
        progress: float,
        shown: Iterator[SequenceBatch] | None = None,
    ) -> None:
        """Make ``updates`` on ``batch_size`` sequences per individual each.

        Parameters
        ----------
        phase
            The numbers of the loss.
        progress
            Share of the training that is over, from 0 to 1; prioritised replay corrects by it.
        shown
            Demonstrated sequences, a minibatch for each update, for terms that ask for them.
        """
        totals: dict[str, torch.Tensor] = {}
        for _ in range(updates):
            batch = buffer.sample(batch_size, progress)
            minibatch = self._values(batch, phase)
            if shown is not None:
                minibatch.demonstrated = self._values(next(shown), phase)
            result = update(
                minibatch, self._terms, self._policy.optimizer, prioritized=buffer.prioritized
            )
            if result.priorities is not None:
                buffer.update_priorities(batch.indices, result.priorities)
            for name, loss in result.losses.items():
                totals[name] = totals[name] + loss if name in totals else loss
            if minibatch.treatment_logits is not None:
                self._treatment_counts += treatment_counts(
                    minibatch.treatment_logits, minibatch.batch.condition, minibatch.valid
                )
        for name, total in totals.items():
            before, number = self.losses.get(name, (torch.zeros_like(total), 0))
            self.losses[name] = (before + total, number + updates)

    def _values(self, batch: SequenceBatch, phase: Phase) -> MinibatchValues:
        policy = self._policy
        return minibatch_values(
            batch,
            phase,
            policy.q_net,
            policy.q_net_target,
            policy.distribution,
            needs_target=self._needs_target,
        )

    def means(self) -> dict[str, list[float]]:
        """Mean of each term over the updates since the last call, one for each individual.

        With a treatment head its balanced accuracy too.
        """
        means = {name: summed / updates for name, (summed, updates) in self.losses.items()}
        if self._treatment_counts.any():
            means["treatment_balanced_accuracy"] = mean_recall(self._treatment_counts)
        self._start_averages()
        return {name: mean.tolist() for name, mean in means.items()}
