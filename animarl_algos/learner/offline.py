"""The offline phase: learning from demonstrations before the first step in the environment.

What is minimised are the recipe's offline terms: cross-entropy (BC), temporal difference with
action supervision (DQAAS), or temporal difference on all actions as scored by the fitted dynamics
(DQDIL, :class:`animarl_algos.losses.terms.ScoredActionsTemporalDifference`). After each epoch the
recipe's validation figure is taken; the weights of the best epoch are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecEnv
from tqdm.auto import tqdm

from animarl_algos.data.slots import SlotLayout
from animarl_algos.learner.gradient_step import minibatch_values, update
from animarl_algos.losses.losses import mean_recall, treatment_counts
from animarl_algos.losses.recipe import Recipe
from animarl_algos.losses.terms import Phase, ScoredActionsTemporalDifference
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.batch import SequenceBatch
from animarl_envs.errors import InputError

Figures = dict[str, float]


class OfflineDataset(Protocol):
    """Demonstrated episodes as sequences; see :mod:`animarl_algos.data.dataset`."""

    def batches(
        self, batch_size: int, generator: np.random.Generator | None = None
    ) -> Iterator[SequenceBatch]:
        """All episodes once, shuffled by ``generator`` or in order."""
        ...


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
    best_epoch, best_figure
        By the recipe's validation figure, the lower the better.
    history
        One row per epoch: ``epoch``, ``train/<term>``, ``val/<figure>``, and both per individual.
    """

    epoch: int = 0
    done: bool = False
    best_epoch: int = 0
    best_figure: float = float("inf")
    history: list[Figures] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        row = asdict(self)
        return row | {"best_figure": None if np.isinf(self.best_figure) else self.best_figure}

    @classmethod
    def from_json(cls, row: dict[str, Any]) -> OfflineProgress:
        figure = row["best_figure"]
        return cls(**row | {"best_figure": float("inf") if figure is None else figure})


class OfflineLearner(Protocol):
    """What the offline phase needs of a learner: its networks, settings and log."""

    recipe: ClassVar[Recipe]
    policy: GruPolicy
    layout: SlotLayout
    env: VecEnv | None
    lr_schedule: Schedule
    device: torch.device
    observation_size: int
    root_seed: int
    offline_epochs: int
    offline_learning_rate: float
    offline_batch_size: int
    offline_patience: int | None
    offline_progress: OfflineProgress
    best_weights: dict[str, torch.Tensor] | None

    @property
    def logger(self) -> Logger: ...

    def phase(self, name: str) -> Phase:
        """The numbers of the ``"offline"`` phase."""
        ...

    def at_boundary(self) -> None:
        """Called before each epoch, when all that a checkpoint holds is whole."""
        ...

    def reset_optimizer(self, learning_rate: float) -> None:
        """A new optimiser for the online network, with nothing accumulated."""
        ...


def run_offline_phase(
    model: OfflineLearner, data: DemonstrationData, *, progress_bar: bool
) -> None:
    """Train ``model`` for its ``offline_epochs``, as ``offline_progress`` left off."""
    progress, policy = model.offline_progress, model.policy
    refuse_foreign(model, data)
    if progress.epoch == 0:
        model.reset_optimizer(model.offline_learning_rate)
    bar = tqdm(
        total=model.offline_epochs,
        initial=progress.epoch,
        desc="offline",
        unit="epoch",
        disable=not progress_bar,
    )
    with bar:
        while progress.epoch < model.offline_epochs:
            model.at_boundary()
            row = train_epoch(model, data.train, progress.epoch)
            policy.q_net_target.load_state_dict(policy.q_net.state_dict())
            row |= validation_figures(model, data.val)
            progress.epoch += 1
            _keep_if_best(model, row[f"val/{model.recipe.selection}"])
            progress.history.append({"epoch": float(progress.epoch)} | row)
            for name, value in row.items():
                model.logger.record(f"offline/{name}", value)
            model.logger.record("offline/epoch", progress.epoch, exclude="tensorboard")
            model.logger.dump(step=progress.epoch)
            bar.update()
            bar.set_postfix(best=progress.best_epoch, figure=f"{progress.best_figure:.3f}")
            patience = model.offline_patience
            if patience is not None and progress.epoch - progress.best_epoch >= patience:
                break
    assert model.best_weights is not None
    policy.q_net.load_state_dict(model.best_weights)
    policy.q_net_target.load_state_dict(model.best_weights)
    model.reset_optimizer(model.lr_schedule(1.0))
    progress.done = True
    model.best_weights = None


def refuse_foreign(model: OfflineLearner, data: DemonstrationData) -> None:
    """Demonstrations of other individuals, another observation or other actions are refused."""
    for name, dataset in (("training", data.train), ("validation", data.val)):
        batch = next(iter(dataset.batches(1)), None)
        if batch is None:
            raise InputError(
                f"the {name} split holds no demonstrated episode: split the data again"
            )
        mine = (model.layout.num_individuals, model.observation_size)
        theirs = (batch.num_individuals, batch.observations.shape[-1])
        if mine != theirs:
            raise InputError(
                f"the {name} demonstrations have {theirs[0]} individuals with {theirs[1]} "
                f"observation components, the environment {mine[0]} with {mine[1]}: "
                "make them for this environment"
            )
        known = getattr(dataset, "individuals", None)  # of this package's datasets, if named
        placed = getattr(model.env, "individuals", None)  # of a VecEnv of slots
        if isinstance(known, tuple) and placed is not None and known != tuple(placed):
            raise InputError(
                f"the {name} demonstrations are of {', '.join(known)}, the environment's "
                f"individuals are {', '.join(model.layout.individuals)}: make them for this "
                "environment"
            )
        scored = batch.action_penalties
        highest = int(batch.actions.max()) if scored is None else scored.shape[-1] - 1
        if highest >= model.policy.num_actions:
            raise InputError(
                f"the {name} demonstrations hold action {highest}, the environment has "
                f"{model.policy.num_actions}: make them for this environment"
            )
        scores = any(isinstance(t, ScoredActionsTemporalDifference) for t in model.recipe.offline)
        if scores and scored is None:
            raise InputError(
                f"the {name} demonstrations carry no penalties of all actions, which "
                f"{model.recipe.name} learns from offline: make the dataset with the fitted "
                "dynamics of their species"
            )


def train_epoch(model: OfflineLearner, dataset: OfflineDataset, epoch: int) -> Figures:
    """One pass over the training split; returns the mean of each term."""
    policy, phase, terms = model.policy, model.phase("offline"), model.recipe.offline
    generator = np.random.default_rng([model.root_seed, epoch])
    totals: dict[str, torch.Tensor] = {}
    updates = 0
    for batch in dataset.batches(model.offline_batch_size, generator):
        minibatch = minibatch_values(
            batch.to(model.device),
            phase,
            policy.q_net,
            policy.q_net_target,
            policy.distribution,
            needs_target=any(term.needs_target for term in terms),
        )
        for name, loss in update(minibatch, terms, policy.optimizer).losses.items():
            totals[name] = totals[name] + loss if name in totals else loss
        updates += 1
    row: Figures = {}
    for name, total in totals.items():
        row |= _per_individual(f"train/{name}", model, (total / updates).cpu().numpy())
    return row


def _keep_if_best(model: OfflineLearner, figure: float) -> None:
    progress = model.offline_progress
    if not np.isfinite(figure):
        raise InputError(
            f"offline training diverged in epoch {progress.epoch} (validation figure {figure}): "
            "lower offline_learning_rate"
        )
    if figure <= progress.best_figure:  # of equals the later: it has been fitted longer
        progress.best_figure, progress.best_epoch = figure, progress.epoch
        state = model.policy.q_net.state_dict()
        model.best_weights = {name: value.cpu().clone() for name, value in state.items()}


def validation_figures(model: OfflineLearner, dataset: OfflineDataset) -> Figures:
    """How the demonstrated actions fare among all actions, over the valid steps of ``dataset``.

    ``val/cross_entropy`` [nat] with action values as logits, ``val/mean_rank`` (best 1; ties count
    half), ``val/top_1`` and ``val/top_3`` (shares ranked first, among the first three), each as the
    mean over individuals and for each; with a treatment head ``val/treatment_balanced_accuracy``.
    """
    shown = demonstrated_values(model, dataset)
    figures: dict[str, list[float]] = {
        "cross_entropy": [], "mean_rank": [], "top_1": [], "top_3": []
    }  # fmt: skip
    for values, actions in zip(shown.values, shown.actions):
        rank = demonstrated_rank(values, actions)
        log_norm = np.log(np.exp(values - values.max(1, keepdims=True)).sum(1)) + values.max(1)
        figures["cross_entropy"].append(
            float(np.mean(log_norm - values[np.arange(len(actions)), actions]))
        )
        figures["mean_rank"].append(float(rank.mean()))
        figures["top_1"].append(float((rank <= 1).mean()))
        figures["top_3"].append(float((rank <= 3).mean()))
    if shown.treatment_accuracy is not None:
        figures["treatment_balanced_accuracy"] = list(shown.treatment_accuracy)
    row: Figures = {}
    for name, per_individual in figures.items():
        row |= _per_individual(f"val/{name}", model, np.array(per_individual))
    return row


def demonstrated_rank(
    values: NDArray[np.floating], actions: NDArray[np.integer]
) -> NDArray[np.float64]:
    """Rank of each demonstrated action among its state's action values: 1 is the highest.

    Ties share their mean rank, so that indifference ranks as chance does. Among values that are not
    all finite there is no rank: NaN.
    """
    own = values[np.arange(len(actions)), actions][:, None]
    higher, equal = (values > own).sum(1), (values == own).sum(1)
    return np.where(np.isfinite(values).all(1), 1 + higher + (equal - 1) / 2, np.nan)


@dataclass(frozen=True)
class DemonstratedValues:
    """Action values at demonstrated states, one entry per individual.

    ``values`` ``(N, A)`` and ``actions`` ``(N,)`` over all valid, labelled steps;
    ``treatment_accuracy`` ``(K,)`` balanced, or None without a treatment head.
    """

    values: list[NDArray[np.float64]]
    actions: list[NDArray[np.int64]]
    treatment_accuracy: NDArray[np.float64] | None


@torch.no_grad()
def demonstrated_values(model: OfflineLearner, dataset: OfflineDataset) -> DemonstratedValues:
    """Run the online network along the demonstrated episodes."""
    policy, count = model.policy, model.layout.num_individuals
    values: list[list[NDArray[np.float64]]] = [[] for _ in range(count)]
    actions: list[list[NDArray[np.int64]]] = [[] for _ in range(count)]
    counts: list[torch.Tensor] = []
    for batch in dataset.batches(model.offline_batch_size):
        minibatch = minibatch_values(
            batch.to(model.device),
            model.phase("offline"),
            policy.q_net,
            policy.q_net_target,
            policy.distribution,
            needs_target=False,
        )
        labels = minibatch.batch.labels
        shown = (minibatch.valid & (labels >= 0)).cpu().numpy()
        q_values = minibatch.q_values.double().cpu().numpy()
        for k in range(count):
            values[k].append(q_values[k][shown[k]])
            actions[k].append(labels[k].cpu().numpy()[shown[k]])
        if minibatch.treatment_logits is not None:
            counts.append(
                treatment_counts(
                    minibatch.treatment_logits, minibatch.batch.condition, minibatch.valid
                )
            )
    if not all(sum(map(len, actions[k])) for k in range(count)):
        raise InputError(
            "the validation split holds no demonstrated action: split the data again, or infer the "
            "actions from the positions first"
        )
    accuracy = mean_recall(torch.stack(counts).sum(0)) if counts else None
    return DemonstratedValues(
        values=[np.concatenate(v) for v in values],
        actions=[np.concatenate(a) for a in actions],
        treatment_accuracy=None if accuracy is None else accuracy.double().cpu().numpy(),
    )


def _per_individual(name: str, model: OfflineLearner, values: NDArray[np.floating]) -> Figures:
    row = {name: float(values.mean())}
    if len(values) > 1:
        row |= {f"{name}/{who}": float(v) for who, v in zip(model.layout.individuals, values)}
    return row
