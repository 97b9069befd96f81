"""One gradient update: evaluate the networks on a minibatch, sum the recipe's terms, step."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.losses.losses import clip_grad_norm_per_individual, share_gradients
from animarl_algos.losses.terms import LossTerm, MinibatchValues, Phase, WeightDecay
from animarl_algos.losses.values import ValueDistribution
from animarl_algos.networks.dropout import DropoutDraws
from animarl_algos.networks.gru import Packing
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.replay.batch import SequenceBatch
from animarl_envs.errors import InputError

PRIORITY_MAX_SHARE = 0.9
"""Priority of a sequence: this share of its largest |TD error|, the rest its mean (Kapturowski et
al. 2019)."""


@dataclass(frozen=True)
class UpdateResult:
    """What one update leaves behind for the replay and the log.

    Attributes
    ----------
    losses
        ``{term: (K,)}``, unweighted.
    priorities
        ``(K, B)``, or None where they are not asked for or no term measures an error.
    """

    losses: dict[str, torch.Tensor]
    priorities: NDArray[np.float64] | None


def minibatch_values(
    batch: SequenceBatch,
    phase: Phase,
    online: StackedQNetwork,
    target: StackedQNetwork,
    distribution: ValueDistribution,
    *,
    needs_target: bool,
    last_states: bool = True,
    dropout: DropoutDraws | None = None,
) -> MinibatchValues:
    """Run the networks over a batch; leading ``burn_in`` steps only rebuild the states.

    Parameters
    ----------
    needs_target
        Whether a term bootstraps from the target network.
    last_states
        False leaves out the states after each sequence's last step, which nothing but a
        bootstrap looks at.
    dropout
        Thins the online network.
    """
    online_state, target_state = batch.initial_state, batch.initial_state
    if batch.burn_in and online.recurrent:
        online_state = _burn_in(online, batch)
        target_state = _burn_in(target, batch) if needs_target else None
    batch = _without_burn_in(batch)
    last_states = last_states or needs_target
    packing = _packing(batch, last_states)
    observations, previous = batch.observations, batch.previous_actions
    if not last_states:
        observations, previous = observations[:, :-1], previous[:, :-1]
    masks = None
    if dropout is not None:
        masks = dropout.masks(online.hidden_layers, batch.batch_size, online.units)
        masks = None if masks is None else masks.to(observations.device)
    output = online(observations, previous, online_state, packing, masks)
    target_output = None
    if needs_target:
        with torch.no_grad():
            target_output = target(
                batch.observations, batch.previous_actions, target_state, packing
            )
    logits = output.treatment_logits
    return MinibatchValues(
        batch=batch,
        phase=phase,
        distribution=distribution,
        valid=batch.mask > 0,
        online=output,
        target=target_output,
        treatment_logits=None if logits is None else logits[:, : batch.num_steps],
        parameters=online.all_parameters,
        shared=online.shared_parameters,
    )


def update(
    minibatch: MinibatchValues,
    terms: Sequence[LossTerm],
    optimizer: torch.optim.Optimizer,
    *,
    prioritized: bool = False,
) -> UpdateResult:
    """Step along the gradient of the terms' weighted sum, clipped for each individual by itself.

    Individuals share no parameter, so the gradient of the sum over individuals is each one's own.
    That of weights which are kept the same for all becomes their mean.

    Raises
    ------
    InputError
        If the sum is not finite: training diverged. Nothing is stepped.
    """
    phase = minibatch.phase
    active = [term for term in terms if term.weight(phase) > 0]
    losses = {term.name: term(minibatch) for term in active}
    total = sum(
        term.weight(phase) * losses[term.name].sum()
        for term in active
        if not isinstance(term, WeightDecay)
    )
    if not isinstance(total, torch.Tensor):
        raise InputError(f"all weights of the {phase.name} loss are 0: give one that is not")
    if not math.isfinite(total.item()):
        raise _diverged(phase, losses)
    for parameter in minibatch.parameters:
        parameter.grad = None
    total.backward()  # type: ignore[no-untyped-call]
    decay = sum(term.weight(phase) for term in active if isinstance(term, WeightDecay))
    if decay:
        _add_decay_gradient(minibatch.parameters, decay)
    if phase.max_grad_norm is not None:
        clip_grad_norm_per_individual(minibatch.parameters, phase.max_grad_norm)
    share_gradients(minibatch.shared)  # clipped ones: what is clipped by own norms differs
    optimizer.step()
    return UpdateResult(
        losses={name: loss.detach() for name, loss in losses.items()},
        priorities=sequence_priorities(minibatch) if prioritized else None,
    )


def _diverged(phase: Phase, losses: dict[str, torch.Tensor]) -> InputError:
    rate = "learning_rate" if phase.name == "online" else "offline_learning_rate"
    shown = ", ".join(f"{name} {loss.detach().tolist()}" for name, loss in losses.items())
    return InputError(
        f"{phase.name} training diverged (losses per individual: {shown}): lower {rate}, and "
        "look for rewards that are huge or not finite"
    )


@torch.no_grad()
def _add_decay_gradient(parameters: Sequence[torch.Tensor], weight: float) -> None:
    """Add ``weight`` times the gradient of the squared norm, which is 2 w.

    Through autograd this would take a third of the time of a small update.
    """
    for parameter in parameters:
        if parameter.grad is None:
            parameter.grad = torch.zeros_like(parameter)
    gradients = [parameter.grad for parameter in parameters]
    torch._foreach_add_(gradients, list(parameters), alpha=2.0 * weight)  # type: ignore[arg-type]


def sequence_priorities(minibatch: MinibatchValues) -> NDArray[np.float64] | None:
    """``(K, B)``: a mixture of each sequence's largest and mean absolute error over valid steps."""
    if minibatch.errors is None:
        return None
    errors = torch.where(minibatch.valid, minibatch.errors, 0.0)
    largest = errors.amax(dim=1)
    mean = errors.sum(dim=1) / minibatch.valid.sum(dim=1).clamp(min=1)
    mixed = PRIORITY_MAX_SHARE * largest + (1.0 - PRIORITY_MAX_SHARE) * mean
    return np.asarray(mixed.cpu().numpy(), dtype=np.float64)


def _without_burn_in(batch: SequenceBatch) -> SequenceBatch:
    b = batch.burn_in
    if b == 0:
        return batch
    scored, shares = batch.action_penalties, batch.label_shares
    return replace(
        batch,
        observations=batch.observations[:, b:],
        previous_actions=batch.previous_actions[:, b:],
        actions=batch.actions[:, b:],
        rewards=batch.rewards[:, b:],
        penalties=batch.penalties[:, b:],
        terminated=batch.terminated[:, b:],
        mask=batch.mask[:, b:],
        labels=batch.labels[:, b:],
        lengths=batch.lengths - b,
        active=batch.active[b:],
        burn_in=0,
        initial_state=None,
        action_penalties=None if scored is None else scored[:, b:],
        label_shares=None if shares is None else shares[:, b:],
    )


def _packing(batch: SequenceBatch, last_states: bool = True) -> Packing:
    """Which rows hold an observation: those of a column's steps, and maybe its last state."""
    active = batch.active if last_states else batch.active[1:]
    return Packing(
        time=batch.num_steps + last_states,
        batch=batch.batch_size,
        active=active[active > 0],
        lengths=batch.lengths.cpu().numpy() + last_states,
        device=batch.observations.device,
    )


@torch.no_grad()
def _burn_in(network: StackedQNetwork, batch: SequenceBatch) -> torch.Tensor:
    """State before the first trained step, ``(K, B, H)``, held until each column's own start."""
    state = batch.initial_state
    if state is None:
        state = network.initial_state(batch.batch_size)
    prefix, starts = batch.burn_in, batch.starts
    # Each column is moved up to begin at its own start, so that all run at once.
    packing = Packing.from_lengths((prefix - starts).cpu().numpy(), prefix, starts.device)
    if not len(packing.active):  # all begin with the trained steps
        return state
    steps = torch.arange(prefix, device=starts.device)[:, None] + starts[..., None, :]
    steps = steps.clamp(max=prefix - 1).expand(len(state), -1, -1)
    observations = batch.observations[:, :prefix]
    rebuilt: torch.Tensor = network(
        observations.gather(1, steps[..., None].expand(observations.shape)),
        batch.previous_actions[:, :prefix].gather(1, steps),
        state,
        packing,
    ).final_state
    return rebuilt
