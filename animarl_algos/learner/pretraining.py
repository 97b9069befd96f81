"""The offline phase: learning from demonstrations before the first step in the environment.

What is minimised are the recipe's offline terms: cross-entropy (BC), temporal difference with
action supervision (DQAAS), or temporal difference on all actions as scored by the fitted dynamics
(DQDIL, :class:`animarl_algos.losses.terms.ScoredActionsTemporalDifference`). After each epoch the
recipe's validation figure of each individual is taken; each keeps the weights of its own best epoch
and stops when it is out of patience, so that individuals trained together end as each would alone.
Those that share a network keep and stop by the mean of their figures.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np
import torch
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv
from tqdm.auto import tqdm

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.settings import OfflineSettings
from animarl_algos.learner.updates import add_losses, minibatch_values, update
from animarl_algos.learner.validation import (
    Figures,
    demonstrated_values,
    named_figures,
    own_figures,
    validation_figures,
)
from animarl_algos.losses.terms import Phase, Recipe, ScoredActionsTemporalDifference, Selection
from animarl_algos.networks.layers import DropoutDraws
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.store import SequenceBatch
from animarl_envs.errors import InputError

Weights = dict[str, torch.Tensor]


class DemonstrationData(Protocol):
    """The two splits that training may see."""

    @property
    def train(self) -> OfflineDataset: ...

    @property
    def val(self) -> OfflineDataset: ...


@dataclass
class OfflineProgress:
    """How far the offline phase is, and its learning curves.

    Attributes
    ----------
    epoch
        Epochs finished.
    done
        Whether the phase is over and the best weights are in place.
    best_epochs, best_figures
        Of each individual, by the recipe's validation figure, the lower the better; empty before
        the first epoch.
    history
        One row per epoch: ``epoch``, ``train/<term>``, ``val/<figure>``, and both per individual.
    best_weights, average_weights
        Of each individual's best epoch, and the moving average where there is one; None once
        ``done``.
    """

    epoch: int = 0
    done: bool = False
    best_epochs: list[int] = field(default_factory=list)
    best_figures: list[float] = field(default_factory=list)
    history: list[Figures] = field(default_factory=list)
    best_weights: Weights | None = field(default=None, compare=False)
    average_weights: Weights | None = field(default=None, compare=False)

    @property
    def best_epoch(self) -> int:
        """The last epoch that was the best of an individual; 0 before the first."""
        return max(self.best_epochs, default=0)

    def running(self, patience: int | None) -> list[bool]:
        """Return which individuals still wait for a better epoch."""
        return [patience is None or self.epoch - best < patience for best in self.best_epochs]

    def over(self, epochs: int, patience: int | None) -> bool:
        """Return whether no epoch is to follow: all are done, or nobody waits for a better one."""
        return self.epoch >= epochs or (self.epoch > 0 and not any(self.running(patience)))

    def to_json(self) -> dict[str, Any]:
        """Return everything but the weights."""
        return {name: getattr(self, name) for name in JSON_FIELDS}

    @classmethod
    def from_json(
        cls, row: dict[str, Any], best: Weights | None, average: Weights | None
    ) -> OfflineProgress:
        """Return the progress that :meth:`to_json` described, with its weights."""
        known = {name: row[name] for name in JSON_FIELDS}
        return cls(**known, best_weights=best, average_weights=average)


JSON_FIELDS = [each.name for each in fields(OfflineProgress) if each.compare]


@dataclass(frozen=True)
class Pretraining:
    """The offline phase of a policy.

    Attributes
    ----------
    policy
        Its networks are trained.
    recipe, phase
        Whose offline terms are minimised, and with which numbers.
    settings
        How minibatches are drawn and steps are taken.
    epochs, learning_rate, batch_size, patience, seed
        See :class:`.settings.LearnerSettings`.
    progress
        How far it is; changed as it goes on.
    """

    policy: GruPolicy
    recipe: Recipe
    phase: Phase
    settings: OfflineSettings
    epochs: int
    learning_rate: float
    batch_size: int
    patience: int | None
    seed: int
    progress: OfflineProgress

    def run(
        self,
        data: DemonstrationData,
        logger: Logger,
        at_boundary: Callable[[], None],
        *,
        progress_bar: bool,
    ) -> None:
        """Train for the rest of the epochs and put each individual's best weights in place.

        ``at_boundary`` is called before each epoch, when all that a checkpoint holds is whole.
        """
        progress, policy = self.progress, self.policy
        if progress.epoch == 0:
            self._begin(data.train)
        bar = tqdm(
            total=self.epochs,
            initial=progress.epoch,
            desc="offline",
            unit="epoch",
            disable=not (progress_bar and sys.stderr.isatty()),
        )
        with bar:
            while not progress.over(self.epochs, self.patience):
                at_boundary()
                row = self.train_epoch(data.train)
                policy.q_net_target.load_state_dict(policy.q_net.state_dict())
                network = self._judged_network()
                row |= self.validate(data.val, network)
                self._keep_best(row, network)
                progress.history.append({"epoch": float(progress.epoch)} | row)
                for name, value in row.items():
                    # Tables on the screen cut long names; those of individuals would be the same.
                    each = "stdout" if name.count("/") > 1 else None
                    logger.record(f"offline/{name}", value, exclude=each)
                logger.record("offline/epoch", progress.epoch, exclude="tensorboard")
                logger.dump(step=progress.epoch)
                bar.update()
                figure = np.mean(progress.best_figures)
                bar.set_postfix(best=progress.best_epoch, figure=f"{figure:.3f}")
        self._warn_if_uninformative()
        assert progress.best_weights is not None
        policy.q_net.load_state_dict(progress.best_weights)
        policy.q_net_target.load_state_dict(progress.best_weights)
        progress.done = True
        progress.best_weights = progress.average_weights = None

    def _begin(self, train: OfflineDataset) -> None:
        """Bring everything into the state before the first update."""
        policy = self.policy
        policy.reset_optimizer(self.learning_rate)
        if self.settings.standardise:
            mean, sd = (each.to(policy.device) for each in train.input_statistics())
            for network in (policy.q_net, policy.q_net_target):
                network.standardise_inputs(mean, sd)
        if self.settings.average:
            weights = policy.q_net.state_dict()
            self.progress.average_weights = {k: v.clone() for k, v in weights.items()}

    def train_epoch(self, dataset: OfflineDataset) -> Figures:
        """Make one pass over the training split; return the mean of each term."""
        policy, settings, epoch = self.policy, self.settings, self.progress.epoch
        terms, individuals = self.recipe.offline, policy.individuals
        needs_target = any(term.needs_target for term in terms)
        generator = np.random.default_rng([self.seed, epoch])
        dropout = DropoutDraws(policy.q_net.dropout, [self.seed, epoch], individuals)
        per_epoch = self.updates_per_epoch(dataset)
        totals: dict[str, torch.Tensor] = {}
        updates = 0
        for batch in self._minibatches(dataset, per_epoch, generator):
            done = epoch * per_epoch + updates
            rate = settings.rate_factor(done, self.epochs * per_epoch) * self.learning_rate
            for group in policy.optimizer.param_groups:
                group["lr"] = rate
            minibatch = minibatch_values(
                policy,
                batch.to(policy.device),
                self.phase,
                needs_target=needs_target,
                last_states=settings.sequence_length is None,
                dropout=dropout,
            )
            losses, _ = update(minibatch, terms, policy.optimizer)
            add_losses(totals, losses)
            if settings.weight_decay:
                _decay(policy.q_net, rate * settings.weight_decay)
            updates += 1
            if self.progress.average_weights is not None:
                decay = settings.average_decay(done + 1)
                _follow(self.progress.average_weights, policy.q_net, decay)
        row: Figures = {}
        for name, total in totals.items():
            row |= named_figures(f"train/{name}", individuals, (total / updates).cpu().numpy())
        return row

    def updates_per_epoch(self, dataset: OfflineDataset) -> int:
        """Return the number of minibatches between two looks at the validation split."""
        if self.settings.sequence_length is None:
            return len(range(0, dataset.num_episodes, self.batch_size))
        return self.settings.updates(dataset.num_steps, self.batch_size)

    def _minibatches(
        self, dataset: OfflineDataset, count: int, generator: np.random.Generator
    ) -> Iterator[SequenceBatch]:
        """Return those of one epoch: all episodes once, or so many windows."""
        settings, size = self.settings, self.batch_size
        if settings.sequence_length is None:
            return dataset.batches(size, generator)
        return dataset.windows(
            size, count, generator, length=settings.sequence_length, burn_in=settings.burn_in
        )

    def validate(self, dataset: OfflineDataset, network: StackedQNetwork | None = None) -> Figures:
        """Return the figures of the policy, or of ``network``, on the validation split."""
        shown = demonstrated_values(self.policy, self.phase, dataset, self.batch_size, network)
        return validation_figures(shown, self.policy.individuals)

    def _judged_network(self) -> StackedQNetwork:
        """Return the online network, or while a moving average is kept that."""
        if self.progress.average_weights is None:
            return self.policy.q_net
        network = self.policy.make_q_net().to(self.policy.device)
        network.load_state_dict(self.progress.average_weights)
        return network

    def _keep_best(self, row: Figures, network: StackedQNetwork) -> None:
        """Count the epoch, and keep the weights of those individuals whose best it is.

        One that is out of patience keeps what it has, as if it were trained alone and had stopped.
        """
        progress, individuals = self.progress, self.policy.individuals
        figures = own_figures(row, f"val/{self.recipe.selection}", individuals)
        if self.policy.q_net.shared:
            figures = [float(np.mean(figures))] * len(individuals)
        if progress.epoch == 0:
            progress.best_epochs = [0] * len(individuals)
            progress.best_figures = [float("inf")] * len(individuals)
        waiting = progress.running(self.patience)
        progress.epoch += 1
        for figure in figures:
            if not np.isfinite(figure):
                raise InputError(
                    f"offline training diverged in epoch {progress.epoch} (validation figure "
                    f"{figure}): lower offline_learning_rate"
                )
        weights = network.state_dict()
        if progress.best_weights is None:
            progress.best_weights = {name: w.cpu().clone() for name, w in weights.items()}
        for k, figure in enumerate(figures):
            # Of equals the later: it has been fitted longer.
            if waiting[k] and figure <= progress.best_figures[k]:
                progress.best_figures[k], progress.best_epochs[k] = figure, progress.epoch
                for name, value in weights.items():
                    progress.best_weights[name][k] = value[k].cpu()

    def _warn_if_uninformative(self) -> None:
        """Name the individuals whose clones are no better than action frequencies."""
        if self.recipe.selection is Selection.MEAN_RANK:
            return  # its values are no logits
        progress, individuals = self.progress, self.policy.individuals
        uninformative = []
        for k, who in enumerate(individuals):
            row = progress.history[progress.best_epochs[k] - 1]
            if own_figures(row, "val/cross_entropy_minus_marginal", individuals)[k] >= 0:
                uninformative.append(who)
        if uninformative:
            warnings.warn(
                f"the clone of {', '.join(uninformative)} is no better than predicting action "
                "frequencies (validation cross-entropy not below the marginal entropy): give more "
                "demonstrations, more updates, or standardised inputs",
                stacklevel=4,
            )


@torch.no_grad()
def _decay(network: StackedQNetwork, share: float) -> None:
    """Take ``share`` of every weight away."""
    torch._foreach_mul_(list(network.all_parameters), 1.0 - share)


@torch.no_grad()
def _follow(average: Weights, network: StackedQNetwork, decay: float) -> None:
    """Move the average of the weights towards the present ones."""
    named = dict(network.named_parameters())
    torch._foreach_lerp_([average[name] for name in named], list(named.values()), 1.0 - decay)


def check_demonstrations(
    data: DemonstrationData, recipe: Recipe, policy: GruPolicy, observation_size: int, env: VecEnv
) -> None:
    """Refuse demonstrations of other individuals, another observation or other actions.

    Raises
    ------
    InputError
        If they do not suit the policy, or lack what the recipe learns from.
    """
    for name, dataset in (("training", data.train), ("validation", data.val)):
        batch = next(iter(dataset.batches(1)), None)
        if batch is None:
            raise InputError(
                f"the {name} split holds no demonstrated episode: split the data again"
            )
        mine = (len(policy.individuals), observation_size)
        theirs = (batch.num_individuals, batch.observations.shape[-1])
        if mine != theirs:
            raise InputError(
                f"the {name} demonstrations have {theirs[0]} individuals with {theirs[1]} "
                f"observation components, the environment {mine[0]} with {mine[1]}: "
                "make them for this environment"
            )
        known = getattr(dataset, "individuals", None)  # of this package's datasets, if named
        placed = getattr(env, "individuals", None)  # of a VecEnv of slots
        if isinstance(known, tuple) and placed is not None and known != tuple(placed):
            raise InputError(
                f"the {name} demonstrations are of {', '.join(known)}, the environment's "
                f"individuals are {', '.join(policy.individuals)}: make them for this environment"
            )
        scored = batch.action_penalties
        highest = int(batch.actions.max()) if scored is None else scored.shape[-1] - 1
        if highest >= policy.num_actions:
            raise InputError(
                f"the {name} demonstrations hold action {highest}, the environment has "
                f"{policy.num_actions}: make them for this environment"
            )
        scores = any(isinstance(t, ScoredActionsTemporalDifference) for t in recipe.offline)
        if scores and scored is None:
            raise InputError(
                f"the {name} demonstrations carry no penalties of all actions, which "
                f"{recipe.name} learns from offline: make the dataset with the fitted dynamics of "
                "their species"
            )
