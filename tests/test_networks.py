"""The stacked networks are what their equations say, and nothing leaks between individuals."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import nn

from animarl_algos.losses import clip_grad_norm_per_individual, masked_mean, squared_l2
from animarl_algos.recurrent import gru as gru_module
from animarl_algos.recurrent.gru import Packing, stacked_gru
from animarl_algos.recurrent.gru_kernels import tanh_float32
from animarl_algos.recurrent.networks import StackedQNetwork
from animarl_algos.recurrent.output import QOutput, dueling_parts
from animarl_algos.values import take_action
from animarl_envs.errors import InputError

NAMES = ("predator_0", "predator_1", "prey")
K, T, B, N, H, A = 3, 7, 4, 5, 6, 4
LENGTHS = np.array([[7, 5, 4, 1], [6, 6, 2, 2], [7, 3, 3, 0]])

devices = pytest.mark.parametrize(
    "device",
    [
        "cpu",
        pytest.param(
            "cuda",
            marks=[
                pytest.mark.cuda,
                pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device"),
            ],
        ),
    ],
)


def make(
    individuals: tuple[str, ...] = NAMES, observation_size: int = N, **kwargs
) -> StackedQNetwork:
    return StackedQNetwork(individuals, observation_size, A, units=H, **kwargs)


def batch(individuals: int = K, features: int = N, seed: int = 0):
    generator = torch.Generator().manual_seed(seed)
    observations = torch.randn(individuals, T, B, features, generator=generator)
    previous = torch.randint(0, A + 1, (individuals, T, B), generator=generator)
    return observations, previous


def valid_steps(lengths: np.ndarray = LENGTHS) -> torch.Tensor:
    return torch.from_numpy(np.arange(T)[None, :, None] < lengths[:, None, :])


def gru_arguments(dtype: torch.dtype, device: str = "cpu", seed: int = 0) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    shapes = [(K, B, H), (K, N, 3 * H), (K, H, 3 * H), (K, 1, 3 * H), (K, 1, 3 * H)]
    draws = [torch.randn(s, generator=generator, dtype=torch.float64) / 2 for s in shapes]
    return [d.to(device, dtype).requires_grad_() for d in draws]


def reference_gru(arguments: list[torch.Tensor], k: int) -> nn.GRU:
    """Individual k's weights in PyTorch's own GRU."""
    _, weight_input, weight_hidden, bias_input, bias_hidden = arguments
    reference = nn.GRU(N, H).to(weight_input.device, weight_input.dtype)
    with torch.no_grad():
        reference.weight_ih_l0.copy_(weight_input[k].T)
        reference.weight_hh_l0.copy_(weight_hidden[k].T)
        reference.bias_ih_l0.copy_(bias_input[k, 0])
        reference.bias_hh_l0.copy_(bias_hidden[k, 0])
    return reference


@devices
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("packed", [False, True])
def test_gru_equals_torch_in_values_and_all_gradients(dtype, packed, device) -> None:
    tolerance = (
        dict(rtol=1e-4, atol=3e-6) if dtype == torch.float32 else dict(rtol=1e-9, atol=1e-11)
    )
    arguments = gru_arguments(dtype, device)
    inputs = batch()[0].to(device, dtype).requires_grad_()
    seen = torch.ones(K, T, B, dtype=torch.bool)
    packing = Packing.full(T, B, device)
    if packed:
        packing, seen = Packing.from_lengths(LENGTHS, T, device), valid_steps()
    upstream = torch.randn(K, T, B, H, dtype=torch.float64).to(device, dtype)
    upstream = upstream * seen[..., None].to(device)
    out = packing.unpack(stacked_gru(packing.pack(inputs), *arguments, packing))
    final = packing.final(packing.pack(out), arguments[0])
    gradients = torch.autograd.grad((out * upstream).sum(), [inputs, *arguments])
    for k in range(K):
        reference = reference_gru(arguments, k)
        one_input = inputs[k].detach().requires_grad_()
        one_state = arguments[0][k].detach().unsqueeze(0).requires_grad_()
        expected, _ = reference(one_input, one_state)
        keep = seen[k].to(device)
        torch.testing.assert_close(out[k][keep], expected[keep], **tolerance)
        (expected * upstream[k]).sum().backward()
        wanted = [
            one_input.grad,
            one_state.grad[0],
            reference.weight_ih_l0.grad.T,
            reference.weight_hh_l0.grad.T,
            reference.bias_ih_l0.grad[None],
            reference.bias_hh_l0.grad[None],
        ]
        for got, want in zip(gradients, wanted):
            torch.testing.assert_close(got[k], want, **tolerance)
        for b in range(B):
            last = int(seen[k, :, b].sum()) - 1
            want = expected[last, b] if last >= 0 else arguments[0][k, b]
            torch.testing.assert_close(final[k, b], want, **tolerance)


def test_gru_gradcheck() -> None:
    packing = Packing.from_lengths(np.array([[3, 2], [3, 0]]), 3)
    shapes = [(2, len(packing.rows), 3), (2, 2, 2), (2, 3, 6), (2, 2, 6), (2, 1, 6), (2, 1, 6)]
    generator = torch.Generator().manual_seed(1)
    arguments = [
        torch.randn(s, generator=generator, dtype=torch.float64, requires_grad=True) for s in shapes
    ]
    assert torch.autograd.gradcheck(lambda *a: stacked_gru(*a, packing), arguments)


def test_kernels_equal_the_tensor_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = gru_arguments(torch.float32)
    packing = Packing.from_lengths(LENGTHS, T)
    inputs = packing.pack(batch()[0]).requires_grad_()
    upstream = torch.randn(K, inputs.shape[1], H)

    def results() -> tuple[torch.Tensor, ...]:
        out = stacked_gru(inputs, *arguments, packing)
        return (out, *torch.autograd.grad(out, [inputs, *arguments], upstream))

    compiled = results()
    monkeypatch.setattr(gru_module.gru_kernels, "usable", lambda tensor: False)
    for got, want in zip(compiled, results()):
        torch.testing.assert_close(got, want, rtol=1e-4, atol=3e-6)


def test_tanh_approximation_is_within_float32_rounding() -> None:
    x = np.linspace(-20, 20, 4001, dtype=np.float32)
    got = np.array([tanh_float32(v) for v in x])
    np.testing.assert_allclose(got, np.tanh(x.astype(np.float64)), atol=4e-7)


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 1, 0, 2]])
def test_packing_keeps_every_valid_step_in_any_order(order: list[int]) -> None:
    lengths = LENGTHS[:, order]
    packing = Packing.from_lengths(lengths, T)
    assert (np.diff(packing.active) <= 0).all()
    observations = batch()[0]
    restored = packing.unpack(packing.pack(observations))
    valid = valid_steps(lengths)
    assert torch.equal(restored[valid], observations[valid])
    if order == [0, 1, 2, 3]:
        assert packing.active.tolist() == [4, 4, 3, 3, 2, 2, 1]


@pytest.mark.parametrize("lengths", [[8, 1], [-1, 3], []])
def test_impossible_lengths_are_refused(lengths: list[int]) -> None:
    with pytest.raises(InputError, match="lengths"):
        Packing.from_lengths(np.array(lengths), T)


def reference_network(
    network: StackedQNetwork, k: int, observations: torch.Tensor, previous: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Q-values, V and raw advantages of individual k, by nn modules and the plain equations."""

    def linear(layer: nn.Module, x: torch.Tensor, columns: slice = slice(None)) -> torch.Tensor:
        return nn.functional.linear(x, layer.weight[k].T[columns], layer.bias[k, 0][columns])

    sensed = observations[..., : network.sensed]
    one_hot = nn.functional.one_hot(previous, A + 1)[..., :A].float()
    x = torch.cat((sensed, one_hot), dim=-1) if network.previous_action else sensed
    x = torch.relu(linear(network.encoder_2, torch.relu(linear(network.encoder_1, x))))
    if network.gru is not None:
        reference = nn.GRU(H, H)
        with torch.no_grad():
            reference.weight_ih_l0.copy_(network.gru.weight_input[k].T)
            reference.weight_hh_l0.copy_(network.gru.weight_hidden[k].T)
            reference.bias_ih_l0.copy_(network.gru.bias_input[k, 0])
            reference.bias_hh_l0.copy_(network.gru.bias_hidden[k, 0])
        x, _ = reference(x)
    if network.condition_flag:
        x = torch.cat((x, observations[..., -1:]), dim=-1)
    head = network.dueling
    value = linear(head.value, torch.relu(linear(head.hidden, x, slice(0, H))))
    advantage = linear(head.advantage, torch.relu(linear(head.hidden, x, slice(H, 2 * H))))
    advantage = advantage.unflatten(-1, (A, network.num_quantiles))
    return value.unsqueeze(-2) + advantage - advantage.mean(-2, keepdim=True), value, advantage


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"recurrent": False},
        {"previous_action": False},
        {"condition_flag": True, "num_quantiles": 3},
    ],
)
def test_network_equals_modules_per_individual(options: dict[str, object]) -> None:
    network = make(**options)
    observations, previous = batch()
    output = network(observations, previous)
    assert output.values.shape == (K, T, B, A, network.num_quantiles)
    assert output.hidden.shape == (K, T, B, H)
    for k in range(K):
        expected, value, advantage = reference_network(network, k, observations[k], previous[k])
        torch.testing.assert_close(output.values[k], expected, rtol=1e-4, atol=1e-5)
        state_value, centred = dueling_parts(output.values[k])
        torch.testing.assert_close(state_value, value, rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(
            centred, advantage - advantage.mean(-2, keepdim=True), rtol=1e-4, atol=1e-5
        )


@pytest.mark.parametrize("quantiles", [1, 5])
def test_values_of_one_action_equal_those_of_all(quantiles: int) -> None:
    """In value and in every gradient, with padding; so do the expected values."""
    network = make(num_quantiles=quantiles)
    observations, previous = batch()
    packing = Packing.from_lengths(LENGTHS, T)
    generator = torch.Generator().manual_seed(5)
    actions = torch.randint(A, (K, T, B), generator=generator)
    weight = torch.randn(K, T, B, quantiles, generator=generator)
    gradients = []
    for of_all in (True, False):
        output = network(observations, previous, None, packing)
        chosen = take_action(output.values, actions) if of_all else output.of_actions(actions)
        expected = output.values.mean(-1) if of_all else output.q_values
        network.zero_grad()
        ((weight * chosen).sum() + (expected * expected).sum()).backward()
        gradients.append(
            [chosen.detach(), expected.detach(), *(p.grad for p in network.parameters())]
        )
    for plain, fast in zip(*gradients, strict=True):
        torch.testing.assert_close(fast, plain, rtol=1e-4, atol=1e-5)


def test_dueling_identities() -> None:
    network = make()
    observations, previous = batch()
    before = network(observations, previous).values
    assert dueling_parts(before)[1].mean(-2).abs().max() < 1e-6
    with torch.no_grad():
        network.dueling.value.bias.add_(5.0)
    after = network(observations, previous).values
    torch.testing.assert_close(after, before + 5.0)
    assert torch.equal(after.argmax(-2), before.argmax(-2))
    with torch.no_grad():  # the same for all actions: invisible
        network.dueling.advantage.bias.add_(3.0)
    torch.testing.assert_close(network(observations, previous).values, after)


def test_initial_weights_depend_on_seed_and_name_alone() -> None:
    together, alone = make(), make(("prey",))
    for (name, stacked), single in zip(together.named_parameters(), alone.parameters()):
        assert torch.equal(stacked[2], single[0]), name
        assert not torch.equal(stacked[0], stacked[1]), name
    other = make(seed=1)
    assert not torch.equal(other.encoder_1.weight, together.encoder_1.weight)


def test_initial_weights_have_torch_bounds() -> None:
    network = StackedQNetwork(NAMES, 12, 13)
    for tensor, fan_in in (
        (network.encoder_1.weight, 25),
        (network.encoder_2.weight, 32),
        (network.gru.weight_hidden, 32),
        (network.dueling.advantage.weight, 32),
    ):
        bound = fan_in**-0.5
        assert 0.95 * bound < tensor.abs().max() <= bound


def test_no_previous_action_carries_no_weight() -> None:
    network = make()
    observations, _ = batch()
    none = torch.full((K, T, B), A)
    output = network(observations, none)
    output.values.square().sum().backward()
    assert network.encoder_1.weight.grad[:, :N].abs().sum() > 0
    assert network.encoder_1.weight.grad[:, N:].abs().sum() == 0


def test_flag_reaches_the_dueling_head_alone() -> None:
    network = make(condition_flag=True, treatment_head=True)
    observations, previous = batch()
    observations[..., -1] = 0
    flipped = observations.clone()
    flipped[..., -1] = 1
    factual, counterfactual = network(observations, previous), network(flipped, previous)
    assert torch.equal(factual.hidden, counterfactual.hidden)
    assert torch.equal(factual.treatment_logits, counterfactual.treatment_logits)
    assert not torch.allclose(factual.values, counterfactual.values)


def test_treatment_head_trains_forwards_and_reverses_backwards() -> None:
    """Its own weights get the plain gradient, all before it minus the strength times that."""
    observations, previous = batch()
    gradients = {}
    for strength in (-1.0, 0.5):  # -1 undoes the reversal
        network = make(treatment_head=True, reversal=strength)
        network(observations, previous).treatment_logits.square().sum().backward()
        gradients[strength] = {n: p.grad for n, p in network.named_parameters()}
    for name, plain in gradients[-1.0].items():
        if name.startswith("dueling"):
            assert plain is None
        elif name.startswith("treatment"):
            torch.testing.assert_close(gradients[0.5][name], plain)
        else:
            assert plain.abs().sum() > 0
            torch.testing.assert_close(gradients[0.5][name], -0.5 * plain)


def sequence_loss(output: QOutput, valid: torch.Tensor) -> torch.Tensor:
    return masked_mean((output.values[..., 0] - 1).square().sum(-1), valid)


@pytest.mark.parametrize("packed", [False, True])
def test_padding_leaks_no_gradient(packed: bool) -> None:
    network = make()
    valid = valid_steps()
    packing = Packing.from_lengths(LENGTHS, T) if packed else None
    gradients = []
    for disturbance in (0.0, 100.0):
        observations, previous = batch()
        observations = observations + disturbance * (~valid)[..., None]
        previous = torch.where(valid, previous, previous if disturbance == 0 else A - previous)
        network.zero_grad()
        sequence_loss(network(observations, previous, None, packing), valid).sum().backward()
        gradients.append([p.grad.clone() for p in network.parameters()])
    for undisturbed, disturbed in zip(*gradients):
        assert torch.equal(undisturbed, disturbed)


def test_packing_changes_no_gradient() -> None:
    network = make()
    valid = valid_steps()
    observations, previous = batch()
    gradients = []
    for packing in (None, Packing.from_lengths(LENGTHS, T)):
        network.zero_grad()
        sequence_loss(network(observations, previous, None, packing), valid).sum().backward()
        gradients.append([p.grad.clone() for p in network.parameters()])
    for full, packed in zip(*gradients):
        torch.testing.assert_close(full, packed, rtol=1e-5, atol=1e-6)


def test_other_individuals_get_no_gradient() -> None:
    network = make(treatment_head=True)
    observations, previous = batch()
    output = network(observations, previous)
    (sequence_loss(output, valid_steps())[0] + output.treatment_logits[0].sum()).backward()
    for parameter in network.parameters():
        assert parameter.grad[0].abs().sum() > 0
        assert parameter.grad[1:].abs().sum() == 0


def train(individuals: tuple[str, ...], rows: list[int]) -> StackedQNetwork:
    """Five Adam steps with clipping, so tight that it always acts, on these individuals' data."""
    network = make(individuals)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-2)
    lengths = LENGTHS[rows]
    for step in range(5):
        observations, previous = batch(seed=step)
        output = network(observations[rows], previous[rows], None, Packing.from_lengths(lengths, T))
        loss = sequence_loss(output, valid_steps(lengths)) + 1e-5 * squared_l2(network.parameters())
        optimizer.zero_grad()
        loss.sum().backward()
        norms = clip_grad_norm_per_individual(network.parameters(), 0.1)
        assert (norms > 0.1).all()
        optimizer.step()
    return network


def test_training_together_equals_one_by_one() -> None:
    together = train(NAMES, [0, 1, 2])
    for k, name in enumerate(NAMES):
        alone = train((name,), [k])
        for (label, stacked), single in zip(together.named_parameters(), alone.parameters()):
            torch.testing.assert_close(stacked[k], single[0], rtol=0, atol=1e-6, msg=label)


@pytest.mark.parametrize("make_options", [{}, {"num_quantiles": 3}, {"recurrent": False}])
def test_step_by_step_equals_the_whole_sequence(make_options: dict[str, object]) -> None:
    network = make(condition_flag=True, **make_options)
    observations, previous = batch()
    output = network(observations, previous)
    state = network.initial_state(B)
    for t in range(T):
        q_values, state = network.step(observations[:, t], previous[:, t], state)
        torch.testing.assert_close(q_values, output.values[:, t].mean(-1), rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(state, output.final_state, rtol=1e-4, atol=1e-6)


def test_a_sequence_in_two_pieces_equals_the_whole() -> None:
    network = make()
    observations, previous = batch()
    whole = network(observations, previous)
    first = network(observations[:, :3], previous[:, :3])
    second = network(observations[:, 3:], previous[:, 3:], first.final_state)
    torch.testing.assert_close(second.values, whole.values[:, 3:], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "build",
    [
        lambda: make(()),
        lambda: make(("prey", "prey")),
        lambda: make(observation_size=1, condition_flag=True),
    ],
)
def test_impossible_networks_are_refused(build: Callable[[], StackedQNetwork]) -> None:
    with pytest.raises(InputError):
        build()
