"""The offline phase: learning from demonstrations before the first step in the environment.

What is minimised are the recipe's offline terms: cross-entropy (BC), temporal difference with
action supervision (DQAAS), or temporal difference on all actions as scored by the fitted dynamics
(DQDIL, :class:`animarl_algos.losses.terms.ScoredActionsTemporalDifference`). After each epoch the
recipe's validation figure of each individual is taken; each keeps the weights of its own best epoch
and stops when it is out of patience, so that individuals trained together end as each would alone.
Those that share a network keep and stop by the mean of their figures.

How minibatches are drawn and steps are taken is in :mod:`animarl_algos.learner.offline_settings`.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from tqdm.auto import tqdm

from animarl_algos.learner.demonstrations import DemonstrationData, OfflineDataset, refuse_foreign
from animarl_algos.learner.gradient_step import minibatch_values, update
from animarl_algos.learner.offline_learner import OfflineLearner
from animarl_algos.learner.validation import (
    Figures,
    judged_network,
    named_figures,
    validation_figures,
)
from animarl_algos.losses.terms import OfflineLoss, Selection
from animarl_algos.networks.dropout import DropoutDraws
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.value_stream import zero_value_stream
from animarl_algos.replay.batch import SequenceBatch
from animarl_envs.errors import InputError


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
    """

    epoch: int = 0
    done: bool = False
    best_epochs: list[int] = field(default_factory=list)
    best_figures: list[float] = field(default_factory=list)
    history: list[Figures] = field(default_factory=list)

    @property
    def best_epoch(self) -> int:
        """The last epoch that was the best of an individual; 0 before the first."""
        return max(self.best_epochs, default=0)

    def running(self, patience: int | None) -> list[bool]:
        """Which individuals still wait for a better epoch."""
        return [patience is None or self.epoch - best < patience for best in self.best_epochs]

    def over(self, epochs: int, patience: int | None) -> bool:
        """Whether no epoch is to follow: there were all of them, or nobody waits for a better."""
        return self.epoch >= epochs or (self.epoch > 0 and not any(self.running(patience)))

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_json(cls, row: dict[str, Any]) -> OfflineProgress:
        progress = cls()
        progress.__setstate__(row)
        return progress

    def __setstate__(self, state: dict[str, Any]) -> None:
        """As stored, also by a version that had one best epoch for all individuals."""
        state = dict(state)
        epoch, figure = state.pop("best_epoch", 0), state.pop("best_figure", None)
        if epoch:
            state |= {"best_epochs": [epoch], "best_figures": [figure]}
        self.__dict__.update(self.__class__().__dict__ | state)


def run_offline_phase(
    model: OfflineLearner, data: DemonstrationData, *, progress_bar: bool
) -> None:
    """Train ``model`` for its ``offline_epochs``, as ``offline_progress`` left off."""
    progress, policy = model.offline_progress, model.policy
    refuse_foreign(model, data)
    if progress.epoch == 0:
        _begin(model, data.train)
    bar = tqdm(
        total=model.offline_epochs,
        initial=progress.epoch,
        desc="offline",
        unit="epoch",
        disable=not (progress_bar and sys.stderr.isatty()),
    )
    with bar:
        while not progress.over(model.offline_epochs, model.offline_patience):
            model.at_boundary()
            row = train_epoch(model, data.train, progress.epoch)
            policy.q_net_target.load_state_dict(policy.q_net.state_dict())
            row |= validation_figures(model, data.val)
            _keep_best(model, row)
            progress.history.append({"epoch": float(progress.epoch)} | row)
            for name, value in row.items():
                # Tables on the screen cut names short, and those of individuals are then the same.
                each = "stdout" if name.count("/") > 1 else None
                model.logger.record(f"offline/{name}", value, exclude=each)
            model.logger.record("offline/epoch", progress.epoch, exclude="tensorboard")
            model.logger.dump(step=progress.epoch)
            bar.update()
            figure = np.mean(progress.best_figures)
            bar.set_postfix(best=progress.best_epoch, figure=f"{figure:.3f}")
    assert model.best_weights is not None
    _warn_of_ignorance(model)
    policy.q_net.load_state_dict(model.best_weights)
    if model.offline_loss == OfflineLoss.CLONING:
        zero_value_stream(policy.q_net)
    policy.q_net_target.load_state_dict(policy.q_net.state_dict())
    model.reset_optimizer(model.lr_schedule(1.0))
    progress.done = True
    model.best_weights = model.average_weights = None


def _begin(model: OfflineLearner, train: OfflineDataset) -> None:
    """Everything as it is before the first update."""
    policy, settings = model.policy, model.offline_settings
    model.reset_optimizer(model.offline_learning_rate)
    if settings.standardise:
        mean, sd = train.input_statistics()
        for network in (policy.q_net, policy.q_net_target):
            network.standardise_inputs(mean.to(model.device), sd.to(model.device))
    if settings.average:
        model.average_weights = {k: v.clone() for k, v in policy.q_net.state_dict().items()}


def train_epoch(model: OfflineLearner, dataset: OfflineDataset, epoch: int) -> Figures:
    """One pass over the training split; returns the mean of each term."""
    policy, phase, terms = model.policy, model.phase("offline"), model.offline_recipe.offline
    settings, individuals = model.offline_settings, model.layout.individuals
    generator = np.random.default_rng([model.root_seed, epoch])
    dropout = DropoutDraws(policy.q_net.dropout, [model.root_seed, epoch], individuals)
    per_epoch = updates_per_epoch(model, dataset)
    totals: dict[str, torch.Tensor] = {}
    updates = 0
    for batch in _minibatches(model, dataset, per_epoch, generator):
        done = epoch * per_epoch + updates
        factor = settings.rate_factor(done, model.offline_epochs * per_epoch)
        _set_rate(policy.optimizer, factor * model.offline_learning_rate)
        minibatch = minibatch_values(
            batch.to(model.device),
            phase,
            policy.q_net,
            policy.q_net_target,
            policy.distribution,
            needs_target=any(term.needs_target for term in terms),
            last_states=settings.sequence_length is None,
            dropout=dropout,
        )
        for name, loss in update(minibatch, terms, policy.optimizer).losses.items():
            totals[name] = totals[name] + loss if name in totals else loss
        if settings.weight_decay:
            _decay(policy.q_net, factor * model.offline_learning_rate * settings.weight_decay)
        updates += 1
        if model.average_weights is not None:
            _follow(model.average_weights, policy.q_net, settings.average_decay(done + 1))
    row: Figures = {}
    for name, total in totals.items():
        row |= named_figures(f"train/{name}", individuals, (total / updates).cpu().numpy())
    return row


def updates_per_epoch(model: OfflineLearner, dataset: OfflineDataset) -> int:
    """Minibatches between two looks at the validation split."""
    settings, batch_size = model.offline_settings, model.offline_batch_size
    if settings.sequence_length is None:
        return sum(1 for _ in range(0, dataset.num_episodes, batch_size))
    return settings.updates(dataset.num_steps, batch_size)


def _minibatches(
    model: OfflineLearner, dataset: OfflineDataset, count: int, generator: np.random.Generator
) -> Iterator[SequenceBatch]:
    """One epoch of them: all episodes once, or so many windows."""
    settings, size = model.offline_settings, model.offline_batch_size
    if settings.sequence_length is None:
        return dataset.batches(size, generator)
    return dataset.windows(
        size, count, generator, length=settings.sequence_length, burn_in=settings.burn_in
    )


def _set_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    for group in optimizer.param_groups:
        group["lr"] = rate


@torch.no_grad()
def _decay(network: StackedQNetwork, share: float) -> None:
    """Take ``share`` of every weight away."""
    torch._foreach_mul_(list(network.all_parameters), 1.0 - share)


@torch.no_grad()
def _follow(average: dict[str, torch.Tensor], network: StackedQNetwork, decay: float) -> None:
    """Move the average of the weights towards the present ones."""
    named = dict(network.named_parameters())
    torch._foreach_lerp_([average[name] for name in named], list(named.values()), 1.0 - decay)


def _keep_best(model: OfflineLearner, row: Figures) -> None:
    """Count the epoch, and keep the weights of those individuals whose best it is.

    One that is out of patience keeps what it has, as if it were trained alone and had stopped.
    """
    progress, individuals = model.offline_progress, model.layout.individuals
    figures = own_figures(row, model.offline_recipe.selection, individuals)
    if model.policy.q_net.shared:
        figures = [float(np.mean(figures))] * len(individuals)
    if len(progress.best_epochs) != len(individuals):  # at the start, or of an older checkpoint
        progress.best_epochs = (progress.best_epochs or [0]) * len(individuals)
        progress.best_figures = (progress.best_figures or [float("inf")]) * len(individuals)
    waiting = progress.running(model.offline_patience)
    progress.epoch += 1
    for figure in figures:
        if not np.isfinite(figure):
            raise InputError(
                f"offline training diverged in epoch {progress.epoch} (validation figure "
                f"{figure}): lower offline_learning_rate"
            )
    weights = judged_network(model).state_dict()
    if model.best_weights is None:
        model.best_weights = {name: value.cpu().clone() for name, value in weights.items()}
    for k, figure in enumerate(figures):
        # Of equals the later: it has been fitted longer.
        if waiting[k] and figure <= progress.best_figures[k]:
            progress.best_figures[k], progress.best_epochs[k] = figure, progress.epoch
            for name, value in weights.items():
                model.best_weights[name][k] = value[k].cpu()


def own_figures(row: Figures, figure: str, individuals: tuple[str, ...]) -> list[float]:
    """A validation figure of each individual."""
    if len(individuals) == 1:
        return [row[f"val/{figure}"]]
    return [row[f"val/{figure}/{who}"] for who in individuals]


def _warn_of_ignorance(model: OfflineLearner) -> None:
    """Say plainly which clones know no more than how often each action is taken."""
    if model.offline_recipe.selection is Selection.MEAN_RANK:
        return  # its values are no logits
    progress, individuals = model.offline_progress, model.layout.individuals
    ignorant = []
    for k, who in enumerate(individuals):
        row = progress.history[progress.best_epochs[k] - 1]
        if own_figures(row, "cross_entropy_minus_marginal", individuals)[k] >= 0:
            ignorant.append(who)
    if ignorant:
        warnings.warn(
            f"the clone of {', '.join(ignorant)} is no better than predicting action frequencies "
            "(validation cross-entropy not below the marginal entropy): give more demonstrations, "
            "more updates, or standardised inputs",
            stacklevel=4,
        )
