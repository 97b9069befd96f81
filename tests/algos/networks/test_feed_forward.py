"""The feed-forward network's compiled loops say and teach what its tensor operations do."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from animarl_algos.networks.kernels import feed_forward
from animarl_algos.networks.layers import Packing
from animarl_algos.networks.networks import StackedQNetwork

NAMES = ("predator_0", "predator_1", "prey")
T, B, N, A = 3, 5, 4, 6
LENGTHS = np.array([[3, 3, 2, 1, 1], [3, 2, 2, 2, 0], [3, 3, 3, 1, 0]])

networks = pytest.mark.parametrize(
    "options",
    [
        {},
        {"n_quantiles": 7},
        {"previous_action": False},
        {"condition_flag": True, "n_quantiles": 3},
        {"condition_flag": True, "treatment_head": True},
        {"condition_flag": True, "condition_input": "encoder"},
        {"hidden": 9},
    ],
    ids=lambda options: "-".join(options) or "plain",
)


def make(individuals: int = 3, **options) -> StackedQNetwork:
    options = {"hidden": 8, "recurrent": False, "previous_action": True} | options
    return StackedQNetwork(NAMES[:individuals], N, A, **options)


def batch(individuals: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    observations = torch.randn(individuals, T, B, N, generator=generator)
    previous = torch.randint(0, A + 1, (individuals, T, B), generator=generator)
    taken = torch.randint(0, A, (individuals, T, B), generator=generator)
    return observations, previous, taken


def outcome(network: StackedQNetwork, packing: Packing | None) -> dict[str, torch.Tensor]:
    """Everything a learner may ask the network for, and the gradient of a loss in all of it."""
    observations, previous, taken = batch(len(network.individuals))
    output = network(observations, previous, packing=packing)
    seen = {
        "features": output.hidden,
        "values": output.values,
        "q_values": output.q_values,
        "taken": output.of_actions(taken),
    }
    if output.treatment_logits is not None:
        seen["treatment"] = output.treatment_logits
    network.zero_grad()
    sum((i + 1) * tensor.square().sum() for i, tensor in enumerate(seen.values())).backward()
    gradients = {f"gradient of {n}": p.grad for n, p in network.named_parameters()}
    return {name: tensor.detach().clone() for name, tensor in (seen | gradients).items()}


@networks
@pytest.mark.parametrize("individuals", [1, 3])
@pytest.mark.parametrize("packed", [False, True])
def test_loops_equal_tensor_operations_in_values_and_gradients(
    individuals, packed, options, monkeypatch
) -> None:
    network = make(individuals, **options)
    packing = Packing.from_lengths(LENGTHS[:individuals], T) if packed else None
    compiled = outcome(network, packing)
    monkeypatch.setattr(feed_forward, "features_and_values", None)  # must not be called
    monkeypatch.setattr(feed_forward, "MOST_ROWS", 0)
    expected = outcome(network, packing)
    assert compiled.keys() == expected.keys()
    for name, tensor in expected.items():
        torch.testing.assert_close(compiled[name], tensor, rtol=1e-5, atol=1e-5, msg=name)
        if name.startswith("gradient"):
            assert tensor.abs().max() > 0, name


def test_many_rows_other_precisions_and_memories_take_the_tensor_operations() -> None:
    few = torch.zeros(2, feed_forward.MOST_ROWS // 2, N)
    assert feed_forward.usable(few)
    assert not feed_forward.usable(torch.zeros(2, feed_forward.MOST_ROWS // 2 + 1, N))
    assert not feed_forward.usable(few.double())
    assert not feed_forward.usable(few.to("meta"))


def test_a_network_computes_with_its_present_weights_wherever_they_come_from() -> None:
    network, other = make(), make(seed=1)
    observations, previous, _ = batch(3)
    expected = other(observations, previous).values
    network(observations, previous)
    network.double().float()  # other memory
    with torch.no_grad():
        network.encoder_1.weight.add_(0.5)
    network.load_state_dict(other.state_dict())
    assert torch.equal(network(observations, previous).values, expected)
    network = make()
    network(observations, previous)
    network.load_state_dict(other.state_dict(), assign=True)  # other parameters
    assert torch.equal(network(observations, previous).values, expected)
    assert all(p is q for p, q in zip(network.all_parameters, network.parameters(), strict=True))


def test_observations_get_their_gradient_from_few_rows_as_from_many(monkeypatch) -> None:
    network = make()
    observations, previous, _ = batch(3)
    observations.requires_grad_()
    (few,) = torch.autograd.grad(network(observations, previous).values.sum(), observations)
    monkeypatch.setattr(feed_forward, "MOST_ROWS", 0)
    (many,) = torch.autograd.grad(network(observations, previous).values.sum(), observations)
    assert torch.equal(few, many)
    assert many.abs().max() > 0


def test_weights_changed_before_the_gradient_are_refused() -> None:
    network = make()
    observations, previous, _ = batch(3)
    loss = network(observations, previous).values.sum()
    with torch.no_grad():
        network.dueling.hidden.weight.mul_(2.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        loss.backward()
