"""The offline phase: learning from demonstrations before the first step in the environment.

What is minimised are the recipe's offline terms: cross-entropy (BC), temporal difference with
action supervision (DQAAS), or temporal difference on all actions as scored by the fitted dynamics
(DQDIL, :class:`animarl_algos.losses.terms.ScoredActionsTemporalDifference`). After each epoch the
recipe's validation figure of each individual is taken; each keeps the weights of its own best epoch
and stops when it is out of patience, so that individuals trained together end as each would alone.
Those that share a network keep and stop by the mean of their figures.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.progress import progress_display
from animarl_algos.learner.settings import LearnerSettings
from animarl_algos.learner.updates import Totals, minibatch_values, update
from animarl_algos.losses.terms import Phase, Recipe, Selection
from animarl_algos.losses.values import mean_recall, treatment_counts
from animarl_algos.networks.layers import DropoutDraws
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy
from animarl_envs.array_types import Floats, Ints
from animarl_envs.errors import InputError

Weights = dict[str, torch.Tensor]
Figures = dict[str, float]
MOST_NAMES = 4  # that a warning lists
MOST_EPISODES = 16
"""Episodes evaluated together: minibatches of windows may be of hundreds, episodes are long."""


@dataclass
class OfflineProgress:
    """How far the offline phase is, and its learning curves.

    Best epochs and figures are of each individual, by the recipe's validation figure (the lower the
    better), and empty before the first epoch. The weights are those of each individual's best
    epoch, and the moving average where there is one; None once ``done``.
    """

    epoch: int = 0  # epochs finished
    done: bool = False  # the phase is over and the best weights are in place
    best_epochs: list[int] = field(default_factory=list)
    best_figures: list[float] = field(default_factory=list)
    # one row per epoch: epoch, train/<term>, val/<figure>, and both per individual
    history: list[Figures] = field(default_factory=list)
    best_weights: Weights | None = field(default=None, compare=False)
    average_weights: Weights | None = field(default=None, compare=False)

    @property
    def best_epoch(self) -> int:
        """The last epoch that was the best of an individual; 0 before the first."""
        return max(self.best_epochs, default=0)

    def running(self, patience: int | None) -> list[bool]:
        """Return which individuals have patience left."""
        return [patience is None or self.epoch - best < patience for best in self.best_epochs]

    def over(self, epochs: int, patience: int | None) -> bool:
        """Return whether training is over: all epochs done, or all individuals out of patience."""
        return self.epoch >= epochs or (self.epoch > 0 and not any(self.running(patience)))

    def to_json(self) -> dict[str, Any]:
        """Return everything but the weights."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.compare}


@dataclass(frozen=True)
class Pretraining:
    """The offline phase of a policy; see :class:`.settings.LearnerSettings` for the numbers."""

    policy: GruPolicy  # its networks are trained
    recipe: Recipe  # its offline terms are minimised
    settings: LearnerSettings
    seed: int
    progress: OfflineProgress  # changed as it goes on

    def run(
        self, data: Any, logger: Logger, at_boundary: Callable[[], None], *, progress_bar: bool
    ) -> None:
        """Train for the rest of the epochs and put each individual's best weights in place.

        ``at_boundary`` is called before each epoch, when all that a checkpoint holds is whole.
        """
        progress, policy = self.progress, self.policy
        if progress.epoch == 0:
            self._begin(data.train)
        bar_options: dict[str, Any] = {"done": progress.epoch, "disable": not progress_bar}
        with progress_display(
            "offline", "epoch", self.settings.offline_epochs, **bar_options
        ) as bar:
            while not progress.over(self.settings.offline_epochs, self.settings.offline_patience):
                at_boundary()
                row = self.train_epoch(data.train)
                policy.q_net_target.load_state_dict(policy.q_net.state_dict())
                network = self._judged_network()
                validated = demonstrated_values(
                    policy,
                    self.settings.phase("offline"),
                    data.val,
                    self.settings.offline_batch_size,
                    network,
                )
                row |= validation_figures(validated, policy.individuals)
                self._keep_best(row, network)
                progress.history.append({"epoch": float(progress.epoch)} | row)
                for name, value in row.items():
                    # Tables on the screen cut long names; those of individuals would be the same.
                    each = "stdout" if name.count("/") > 1 else None
                    logger.record(f"offline/{name}", value, exclude=each)
                logger.record("offline/epoch", progress.epoch, exclude="tensorboard")
                logger.dump(step=progress.epoch)
                figure = np.mean(progress.best_figures)
                bar.set_postfix(best=progress.best_epoch, figure=f"{figure:.3f}", refresh=False)
                bar.update()
        self._warn_if_uninformative()
        assert progress.best_weights is not None
        policy.q_net.load_state_dict(progress.best_weights)
        policy.q_net_target.load_state_dict(progress.best_weights)
        progress.done = True
        progress.best_weights = progress.average_weights = None

    def _begin(self, train: OfflineDataset) -> None:
        """Bring everything into the state before the first update."""
        policy = self.policy
        policy.reset_optimizer(self.settings.offline_learning_rate)
        if self.settings.offline.standardise:
            mean, sd = (each.to(policy.device) for each in train.input_statistics())
            for network in (policy.q_net, policy.q_net_target):
                network.standardise_inputs(mean, sd)
        if self.settings.offline.average:
            weights = policy.q_net.state_dict()
            self.progress.average_weights = {k: v.clone() for k, v in weights.items()}

    def train_epoch(self, dataset: OfflineDataset) -> Figures:
        """Make one pass over the training split; return the mean of each term."""
        policy, settings, epoch = self.policy, self.settings.offline, self.progress.epoch
        terms, individuals, size = (
            self.recipe.offline,
            policy.individuals,
            self.settings.offline_batch_size,
        )
        needs_target = any(term.needs_target for term in terms)
        generator = np.random.default_rng([self.seed, epoch])
        dropout = DropoutDraws(policy.q_net.dropout, [self.seed, epoch], individuals)
        length = settings.sequence_length
        if length is None:  # all episodes once
            per_epoch = len(range(0, dataset.num_episodes, size))
            batches = dataset.batches(size, generator)
        else:
            per_epoch = settings.updates(dataset.num_steps, size)
            batches = dataset.windows(
                size, per_epoch, generator, length=length, burn_in=settings.burn_in
            )
        totals: Totals = {}
        for done, batch in enumerate(batches, start=epoch * per_epoch):
            rate = (
                settings.rate_factor(done, self.settings.offline_epochs * per_epoch)
                * self.settings.offline_learning_rate
            )
            for group in policy.optimizer.param_groups:
                group["lr"] = rate
            minibatch = minibatch_values(
                policy,
                batch.to(policy.device),
                self.settings.phase("offline"),
                needs_target=needs_target,
                last_states=length is None,
                dropout=dropout,
            )
            losses, _ = update(minibatch, terms, policy.optimizer)
            for name, loss in losses.items():
                totals[name] = totals[name] + loss if name in totals else loss
            with torch.no_grad():
                if settings.weight_decay:
                    share = rate * settings.weight_decay  # that is taken away of every weight
                    torch._foreach_mul_(list(policy.q_net.all_parameters), 1.0 - share)
                if (average := self.progress.average_weights) is not None:
                    decay = min(settings.average, (2 + done) / (11 + done))
                    weights = dict(policy.q_net.named_parameters())
                    followers = [average[name] for name in weights]
                    torch._foreach_lerp_(followers, list(weights.values()), 1.0 - decay)
        row: Figures = {}
        for name, total in totals.items():
            row |= named_figures(f"train/{name}", individuals, (total / per_epoch).cpu().numpy())
        return row

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
        waiting = progress.running(self.settings.offline_patience)
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
        name, uninformative = "val/cross_entropy_minus_marginal", []
        for k, individual in enumerate(individuals):
            row = progress.history[progress.best_epochs[k] - 1]
            if own_figures(row, name, individuals)[k] >= 0:
                uninformative.append(individual)
        if uninformative:
            warnings.warn(
                f"the clone of {few_or_count(uninformative)} is no better than predicting action "
                "frequencies (validation cross-entropy not below the marginal entropy): give more "
                "demonstrations, more updates, or standardised inputs",
                stacklevel=4,
            )


def few_or_count(names: list[str]) -> str:
    """Return the names, or of many how many they are."""
    return ", ".join(names) if len(names) <= MOST_NAMES else f"{len(names)} individuals"


# -- validation -----------------------------------------------------------------------------------


class DemonstratedValues(NamedTuple):
    """Action values over all valid, labelled steps of demonstrations, one entry per individual."""

    values: list[Floats]  # (N, A)
    actions: list[Ints]  # (N,)
    shares: list[Floats | None]  # (N, A), soft labels, None where there are none
    treatment_accuracy: Floats | None  # (K,), balanced; None without a treatment head


@torch.no_grad()
def demonstrated_values(
    policy: GruPolicy,
    phase: Phase,
    dataset: OfflineDataset,
    batch_size: int,
    network: StackedQNetwork | None = None,
) -> DemonstratedValues:
    """Return the values along demonstrated episodes: the policy's, or those of ``network``."""
    parts: list[list[list[NDArray[Any]]]] = [[[], [], []] for _ in policy.individuals]
    counts: list[torch.Tensor] = []
    for batch in dataset.batches(min(batch_size, MOST_EPISODES)):
        minibatch = minibatch_values(
            policy, batch.to(policy.device), phase, needs_target=False, network=network
        )
        labels, soft = minibatch.batch.labels, minibatch.batch.label_shares
        labelled = minibatch.valid & (labels >= 0)
        for k, (values, actions, shares) in enumerate(parts):
            values.append(minibatch.q_values[k][labelled[k]].double().cpu().numpy())
            actions.append(labels[k][labelled[k]].cpu().numpy())
            if soft is not None:
                shares.append(soft[k][labelled[k]].double().cpu().numpy())
        if (logits := minibatch.treatment_logits) is not None:
            counts.append(treatment_counts(logits, minibatch.batch.condition, minibatch.valid))
    if not all(sum(map(len, actions)) for _, actions, _ in parts):
        raise InputError(
            "the validation split holds no demonstrated action: split the data again, or infer the "
            "actions from the positions first"
        )
    accuracy = mean_recall(torch.stack(counts).sum(0)).double().cpu().numpy() if counts else None
    return DemonstratedValues(
        [np.concatenate(values) for values, _, _ in parts],
        [np.concatenate(actions) for _, actions, _ in parts],
        [np.concatenate(shares) if shares else None for _, _, shares in parts],
        accuracy,
    )


def validation_figures(seen: DemonstratedValues, individuals: tuple[str, ...]) -> Figures:
    """Return how the demonstrated actions fare among all actions.

    ``val/cross_entropy`` [nat] with action values as logits, ``val/label_cross_entropy`` the same
    of the labels learned from (soft ones too) and ``val/cross_entropy_minus_marginal`` that minus
    the entropy of the labels' mean: what cloning without looking at the observation could reach,
    so that below 0 something is known. ``val/mean_rank`` (best 1; ties count half), ``val/top_1``
    and ``val/top_3`` (shares ranked first, among the first three), each as the mean over
    individuals and for each; with a treatment head ``val/treatment_balanced_accuracy``.
    """
    figures = []
    for values, actions, shares in zip(seen.values, seen.actions, seen.shares, strict=True):
        rank = demonstrated_rank(values, actions)
        log_norm = np.log(np.exp(values - values.max(1, keepdims=True)).sum(1)) + values.max(1)
        hard = soft = float(np.mean(log_norm - values[np.arange(len(actions)), actions]))
        mean = np.bincount(actions, minlength=values.shape[1]) / len(actions)
        if shares is not None:
            soft = float(np.mean(log_norm - (shares * values).sum(1)))
            mean = shares.mean(0)
        mean = mean[mean > 0]
        marginal = float(-(mean * np.log(mean)).sum())
        figures.append(
            {
                "cross_entropy": hard,
                "label_cross_entropy": soft,
                "cross_entropy_minus_marginal": soft - marginal,
                "mean_rank": float(rank.mean()),
                "top_1": float((rank <= 1).mean()),
                "top_3": float((rank <= 3).mean()),
            }
        )
        if seen.treatment_accuracy is not None:
            figures[-1]["treatment_balanced_accuracy"] = seen.treatment_accuracy[len(figures) - 1]
    row: Figures = {}
    for name in figures[0]:
        row |= named_figures(f"val/{name}", individuals, np.array([own[name] for own in figures]))
    return row


def named_figures(name: str, individuals: tuple[str, ...], values: NDArray[np.floating]) -> Figures:
    """Return the mean over individuals, and where there are several each one's own."""
    row = {name: float(values.mean())}
    if len(values) > 1:
        row |= {f"{name}/{one}": float(v) for one, v in zip(individuals, values)}
    return row


def own_figures(row: Figures, name: str, individuals: tuple[str, ...]) -> list[float]:
    """Return each individual's own figure of :func:`named_figures`."""
    if len(individuals) == 1:
        return [row[name]]
    return [row[f"{name}/{one}"] for one in individuals]


def demonstrated_rank(values: NDArray[np.floating], actions: NDArray[np.integer]) -> Floats:
    """Return the rank of each demonstrated action among its state's values: 1 is the highest.

    Ties share their mean rank, so that indifference ranks as chance does. Among values that are not
    all finite there is no rank: NaN.
    """
    own = values[np.arange(len(actions)), actions][:, None]
    higher, equal = (values > own).sum(1), (values == own).sum(1)
    return np.where(np.isfinite(values).all(1), 1 + higher + (equal - 1) / 2, np.nan)


# -- temperatures ----------------------------------------------------------------------------------

LOG_TEMPERATURE_SD = 0.5
"""How far the logarithm of a temperature lies from 0 before any action was looked at."""


def boltzmann_nll(
    values: NDArray[np.floating], actions: NDArray[np.integer], temperature: float
) -> float:
    """Return the mean negative log-likelihood [nat] of ``actions`` (N,).

    Under ``softmax(values / temperature)``, ``values`` ``(N, A)`` being action values or logits.
    """
    scaled = values / temperature
    scaled = scaled - scaled.max(axis=1, keepdims=True)
    log_norm = np.log(np.exp(scaled).sum(axis=1))
    return float(np.mean(log_norm - scaled[np.arange(len(actions)), actions]))


def fit_boltzmann_temperature(values: NDArray[np.floating], actions: NDArray[np.integer]) -> float:
    """Return the likeliest temperature, searched over ten decades around the values' own spread.

    A priori its logarithm is normal around 0, the temperature of a clone's logits, with standard
    deviation ``LOG_TEMPERATURE_SD``. Some hundred actions outweigh that; but of a few that are all
    the same, as of animals at rest, the likelihood alone would have them never move again.

    The likelihood is unimodal in the inverse temperature (the log-likelihood of a one-parameter
    exponential family is concave), so a bounded scalar search finds it. Raises InputError if there
    is no demonstrated action to fit to, or the values are all equal.
    """
    from scipy.optimize import minimize_scalar

    if len(actions) == 0:
        raise InputError("no demonstrated action to fit a temperature to: give a larger dataset")
    values = values.astype(np.float64)
    spread = float(np.mean(values.std(axis=1)))
    if not spread > 0:
        raise InputError(
            "the action values are all equal or not finite: train before fitting a temperature"
        )
    result = minimize_scalar(
        lambda log_t: (
            len(actions) * boltzmann_nll(values, actions, spread * np.exp(log_t))
            + ((log_t + np.log(spread)) / LOG_TEMPERATURE_SD) ** 2 / 2
        ),
        bounds=(np.log(1e-5), np.log(1e5)),
        method="bounded",
        options={"xatol": 1e-4},
    )
    return float(spread * np.exp(result.x))
