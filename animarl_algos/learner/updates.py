"""Updates: when they are due, and one gradient step on a minibatch."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import should_collect_more_steps

from animarl_algos.losses.terms import LossTerm, MinibatchValues, Phase, WeightDecay
from animarl_algos.losses.values import (
    clip_grad_norm_per_individual,
    denormals_as_zero,
    share_gradients,
)
from animarl_algos.networks.layers import DropoutDraws, Packing
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.store import BY_STEP, SequenceBatch
from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError

AS_MANY_AS_STEPS = -1
"""Value of ``gradient_steps``, as in stable-baselines3."""
PRIORITY_MAX_SHARE = 0.9
"""Priority of a sequence: this share of its largest |TD error|, the rest its mean (Kapturowski et
al. 2019)."""
Totals = dict[str, torch.Tensor]


INPUT_CLIP = 1000.0
"""Inputs standardised by random steps are clipped at so many sd: learnt behaviour goes farther."""


@dataclass
class UpdateSchedule:
    """Counts steps and episodes, and says when to learn from the memory."""

    steps: int = 0  # of every copy, since the last updates
    episodes: int = 0  # finished ones of all copies, since the last updates
    updates_due: float = 0.0  # not yet made; a fraction of one is kept
    since_target: int = 0  # steps of the world or episodes since the target network's last update

    def restart_rollout(self) -> None:
        """Forget what was collected since the last updates."""
        self.steps = self.episodes = 0

    def count_step(self, episodes: int) -> None:
        """Count one step of every copy, in which so many ``episodes`` finished."""
        self.steps += 1
        self.episodes += episodes

    def needs_more_steps(self, frequency: TrainFreq) -> bool:
        """Return whether more is to be collected before the next updates."""
        return should_collect_more_steps(frequency, self.steps, self.episodes)

    def take_updates(
        self, frequency: TrainFreq, *, copies: int, gradient_steps: int, updates_per_episode: float
    ) -> int:
        """Return the updates that are due after a whole rollout, and begin the next one."""
        if frequency.unit is TrainFrequencyUnit.EPISODE:
            self.updates_due += updates_per_episode * self.episodes
        elif gradient_steps == AS_MANY_AS_STEPS:
            self.updates_due += self.steps * copies
        else:
            self.updates_due += gradient_steps
        self.restart_rollout()
        updates, self.updates_due = int(self.updates_due), self.updates_due % 1.0
        return updates

    def is_target_due(self, frequency: TrainFreq, steps: int, episodes: int) -> bool:
        """Count world ``steps`` and ``episodes``; return whether to update the target network."""
        self.since_target += steps if frequency.unit is TrainFrequencyUnit.STEP else episodes
        due = self.since_target >= frequency.frequency
        if due:
            self.since_target %= frequency.frequency
        return due


# -- one update -----------------------------------------------------------------------------------


@denormals_as_zero()
def minibatch_values(
    policy: GruPolicy,
    batch: SequenceBatch,
    phase: Phase,
    *,
    needs_target: bool,
    last_states: bool = True,
    dropout: DropoutDraws | None = None,
    network: StackedQNetwork | None = None,
) -> MinibatchValues:
    """Run the networks over a batch; leading ``burn_in`` steps only rebuild the states.

    ``last_states=False`` leaves out the states after each sequence's last step, which nothing but a
    bootstrap from the target network looks at. ``dropout`` draws masks for the online network's
    hidden units; ``network`` is evaluated instead of it.
    """
    online, target = network or policy.q_net, policy.q_net_target
    online_state, target_state = batch.initial_state, batch.initial_state
    if batch.burn_in and online.recurrent:
        online_state = _burn_in(online, batch)
        target_state = _burn_in(target, batch) if needs_target else None
    batch = _without_burn_in(batch)
    observations, previous = batch.observations, batch.previous_actions
    successors = None
    if needs_target and batch.num_steps == 1 and not online.recurrent:
        # The states after single steps need no gradient, those before no target.
        after = observations[:, 1:], previous[:, 1:]
        with torch.no_grad():
            successors, target_output = online(*after), target(*after)
        packing = Packing.full(1, batch.batch_size, observations.device)
        last_states = needs_target = False
    else:
        target_output = None
        last_states = last_states or needs_target
        lengths, time = batch.lengths.cpu().numpy() + last_states, batch.num_steps + last_states
        packing = Packing.from_lengths(lengths, time, observations.device)
    if not last_states:
        observations, previous = observations[:, :-1], previous[:, :-1]
    masks = None
    if dropout is not None:
        layers = online.depth + online.recurrent
        masks = dropout.masks(layers, batch.batch_size, online.units)
        masks = None if masks is None else masks.to(observations.device)
    output = online(observations, previous, online_state, packing, masks)
    if needs_target:
        with torch.no_grad():
            target_output = target(
                batch.observations, batch.previous_actions, target_state, packing
            )
    logits = output.treatment_logits
    return MinibatchValues(
        batch=batch,
        phase=phase,
        distribution=policy.distribution,
        valid=batch.mask > 0,
        online=output,
        target=target_output,
        successors=successors,
        treatment_logits=None if logits is None else logits[:, : batch.num_steps],
        parameters=online.all_parameters,
        shared=online.shared_parameters,
    )


@denormals_as_zero()
def update(
    minibatch: MinibatchValues,
    terms: Sequence[LossTerm],
    optimizer: torch.optim.Optimizer,
    *,
    prioritized: bool = False,
) -> tuple[Totals, Floats | None]:
    """Step along the gradient of the terms' weighted sum, clipped for each individual by itself.

    Individuals share no parameter, so the gradient of the sum over individuals is each one's own.
    That of weights which are kept the same for all becomes their mean.

    Raises InputError if the sum is not finite: training diverged. No step is made then.

    Returns
    -------
    losses
        ``{term: (K,)}``, unweighted.
    priorities
        ``(K, B)``, or None where they are not asked for or no term measures an error.
    """
    phase = minibatch.phase
    active = [term for term in terms if term.weight(phase) > 0]
    losses = {term.name: term(minibatch) for term in active}
    summed = [
        losses[term.name].sum() * term.weight(phase)
        for term in active
        if not isinstance(term, WeightDecay)
    ]
    if not summed:
        raise InputError(f"all {phase.name} loss weights are 0: set at least one above 0")
    total = sum(summed[1:], summed[0])
    minibatch.total = total.item()
    if not math.isfinite(minibatch.total):
        rate = "learning_rate" if phase.name == "online" else "offline_learning_rate"
        by_name = ", ".join(f"{name} {loss.detach().tolist()}" for name, loss in losses.items())
        raise InputError(
            f"{phase.name} training diverged (losses per individual: {by_name}): lower {rate}, and "
            "look for rewards that are huge or not finite"
        )
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
    priorities = sequence_priorities(minibatch) if prioritized else None
    return {name: loss.detach() for name, loss in losses.items()}, priorities


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


def sequence_priorities(minibatch: MinibatchValues) -> Floats | None:
    """Return a mixture of each sequence's largest and mean absolute error over valid steps, (K, B).

    None if no term measured an error.
    """
    if minibatch.errors is None:
        return None
    errors = torch.where(minibatch.valid, minibatch.errors, 0.0)
    mean = errors.sum(dim=1) / minibatch.valid.sum(dim=1).clamp(min=1)
    mixed = PRIORITY_MAX_SHARE * errors.amax(dim=1) + (1.0 - PRIORITY_MAX_SHARE) * mean
    return np.asarray(mixed.cpu().numpy(), dtype=np.float64)


def _without_burn_in(batch: SequenceBatch) -> SequenceBatch:
    b = batch.burn_in
    if b == 0:
        return batch
    present = ((name, getattr(batch, name)) for name in BY_STEP)
    cut = {name: value[:, b:] for name, value in present if value is not None}
    return replace(batch, burn_in=0, initial_state=None, lengths=batch.lengths - b, **cut)


@torch.no_grad()
def _burn_in(network: StackedQNetwork, batch: SequenceBatch) -> torch.Tensor:
    """Return the state before the first trained step, (K, B, H), held until each column's start."""
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


def standardise_inputs(policy: GruPolicy, buffer: SequenceReplayBuffer, *, done: bool) -> None:
    """Standardise the networks' inputs by what the memory holds now, once for all.

    What was standardised before, in the offline phase too, stays, and so do the inputs that a
    network has learned from in an offline phase as they were: ``done`` says that it is over.
    """
    if done or torch.isfinite(policy.q_net.input_limit).all():
        return
    mean, sd = (torch.from_numpy(each).to(policy.device) for each in buffer.moments())
    for network in (policy.q_net, policy.q_net_target):
        network.standardise_inputs(mean, sd, limit=INPUT_CLIP)
