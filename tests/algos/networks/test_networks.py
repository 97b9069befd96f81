"""The stacked networks are what their equations say, and nothing leaks between individuals."""

import json
from typing import Any

import numpy as np
import pytest
import torch
from reference_learner import run_network
from refusals import refuses
from torch import nn

from animarl_algos.losses.values import masked_mean, share_gradients, take_action
from animarl_algos.networks.acting_rule import Acting, two_stage_logits
from animarl_algos.networks.layers import DropoutDraws, Packing, StackedGRU
from animarl_algos.networks.networks import QOutput, StackedQNetwork

K, T, B, N, H, A = 3, 7, 4, 5, 6, 4  # individuals, steps, sequences, components, units, actions
LENGTHS = np.array([[7, 5, 4, 1], [6, 6, 2, 2], [7, 3, 3, 0]])


def batch(seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Observations ``(K, T, B, N)`` and previous actions ``(K, T, B)``, ``A`` for none."""
    generator = torch.Generator().manual_seed(seed)
    observations = torch.randn(K, T, B, N, generator=generator)
    previous = torch.randint(0, A + 1, (K, T, B), generator=generator)
    return observations, previous


def valid_steps(lengths: np.ndarray = LENGTHS) -> torch.Tensor:
    """``(K, T, B)``: the steps that are no padding."""
    return torch.from_numpy(np.arange(T)[None, :, None] < lengths[:, None, :])


def torch_gru(
    k: int,
    weight_input: torch.Tensor,
    weight_hidden: torch.Tensor,
    bias_input: torch.Tensor,
    bias_hidden: torch.Tensor,
) -> nn.GRU:
    """Individual k's weights in PyTorch's own GRU."""
    _, inputs, units = weight_input.shape
    reference = nn.GRU(inputs, units // 3).to(weight_input.device, weight_input.dtype)
    with torch.no_grad():
        reference.weight_ih_l0.copy_(weight_input[k].T)
        reference.weight_hh_l0.copy_(weight_hidden[k].T)
        reference.bias_ih_l0.copy_(bias_input[k, 0])
        reference.bias_hh_l0.copy_(bias_hidden[k, 0])
    return reference


NAMES = ("predator_0", "predator_1", "prey")


def make(
    individuals: tuple[str, ...] = NAMES, observation_size: int = N, **kwargs
) -> StackedQNetwork:
    return StackedQNetwork(
        individuals, observation_size, A, hidden=H, **{"previous_action": True} | kwargs
    )


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"recurrent": False},
        {"previous_action": False},
        {"condition_flag": True, "n_quantiles": 3},
    ],
)
def test_network_equals_its_equations_per_individual(options: dict[str, object]) -> None:
    network = make(**options)
    observations, previous = batch()
    output = network(observations, previous)
    assert output.values.shape == (K, T, B, A, network.num_quantiles)
    assert output.hidden.shape == (K, T, B, H)
    for k in range(K):
        weights = {name: p[k].detach().double() for name, p in network.named_parameters()}
        for b in range(B):
            seen, before = observations[k, :, b].double(), previous[k, :, b].tolist()
            start = torch.zeros(H, dtype=torch.float64)
            values, *_ = run_network(network, weights, seen, before, start)
            found = output.values[k, :, b].double()
            torch.testing.assert_close(found, values, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("quantiles", [None, 5])
def test_values_of_one_action_equal_those_of_all(quantiles: int | None) -> None:
    """In value and in every gradient, with padding; so do the expected values."""
    network = make(n_quantiles=quantiles)
    observations, previous = batch()
    packing = Packing.from_lengths(LENGTHS, T)
    generator = torch.Generator().manual_seed(5)
    actions = torch.randint(A, (K, T, B), generator=generator)
    weight = torch.randn(K, T, B, quantiles or 1, generator=generator)
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


def test_initial_weights_depend_on_seed_and_name_alone() -> None:
    together, alone = make(), make(("prey",))
    for (name, stacked), single in zip(together.named_parameters(), alone.parameters()):
        assert torch.equal(stacked[2], single[0]), name
        assert not torch.equal(stacked[0], stacked[1]), name
    other = make(seed=1)
    assert not torch.equal(other.encoder_1.weight, together.encoder_1.weight)


def both_conditions(network: StackedQNetwork) -> tuple[QOutput, QOutput]:
    """What a network says about the same sequences under conditions 0 and 1."""
    observations, previous = batch()
    observations[..., -1] = 0
    flipped = observations.clone()
    flipped[..., -1] = 1
    return network(observations, previous), network(flipped, previous)


@pytest.mark.parametrize(
    "options", [{}, {"head_layers": 0}, {"skip": True, "head_layers": 0}, {"n_quantiles": 3}]
)
def test_flag_reaches_the_dueling_head_alone(options: dict[str, object]) -> None:
    network = make(condition_flag=True, treatment_head=True, **options)
    factual, counterfactual = both_conditions(network)
    assert torch.equal(factual.hidden, counterfactual.hidden)
    assert torch.equal(factual.treatment_logits, counterfactual.treatment_logits)
    assert not torch.allclose(factual.values, counterfactual.values)


@pytest.mark.parametrize("head_layers", [0, 1])
@pytest.mark.parametrize("condition_input", ["head", "encoder"])
@pytest.mark.parametrize("recurrent", [False, True])
def test_effect_of_the_flag_on_the_advantage_differs_between_states(
    recurrent: bool, condition_input: str, head_layers: int
) -> None:
    """Otherwise the condition could only make an action better or worse everywhere."""
    options = {"condition_input": condition_input, "head_layers": head_layers}
    network = make(condition_flag=True, recurrent=recurrent, **options)
    factual, counterfactual = (o.q_values for o in both_conditions(network))
    effect = (counterfactual - factual).flatten(1, 2)
    advantage = effect - effect.mean(-1, keepdim=True)
    assert (advantage.std(dim=1) > 1e-4).all()  # added up: rounding, 1e-8


def test_flag_in_the_encoder_is_standardised_as_any_other_component() -> None:
    network = make(condition_flag=True, condition_input="encoder", recurrent=False)
    plain = make(recurrent=False)
    observations, previous = batch()
    mean, sd = torch.full((K, N), 0.5), torch.full((K, N), 0.25)
    for each in (network, plain):
        each.standardise_inputs(mean, sd)
    expected = plain(observations, previous).values
    assert torch.equal(network(observations, previous).values, expected)


def sequence_loss(output: QOutput, valid: torch.Tensor) -> torch.Tensor:
    return masked_mean((output.values[..., 0] - 1).square().sum(-1), valid)


def test_a_shared_network_learns_from_all_and_keeps_its_biases() -> None:
    """As one network that is told whom it moves would: the mean gradient, own biases."""
    together, alone = make(shared=True), [make(NAMES[:1]) for _ in NAMES]
    for step in range(3):
        observations, previous = batch(seed=step)
        for network in (together, *alone):
            network.zero_grad()
        sequence_loss(together(observations, previous), valid_steps()).sum().backward()
        share_gradients(together.shared_parameters)
        torch.optim.SGD(together.parameters(), lr=0.1).step()
        for k, network in enumerate(alone):
            rows = slice(k, k + 1)
            output = network(observations[rows], previous[rows])
            sequence_loss(output, valid_steps(LENGTHS[rows])).sum().backward()
        for label, _ in alone[0].named_parameters():
            each = [dict(network.named_parameters())[label] for network in alone]
            if "bias" not in label:
                mean = torch.stack([p.grad for p in each]).mean(0)
                for parameter in each:
                    parameter.grad.copy_(mean)
        for network in alone:
            torch.optim.SGD(network.parameters(), lr=0.1).step()
    for label, stacked in together.named_parameters():
        for k, network in enumerate(alone):
            single = dict(network.named_parameters())[label][0]
            torch.testing.assert_close(stacked[k], single, rtol=0, atol=1e-6, msg=label)
        assert torch.equal(stacked[0], stacked[1]) == ("bias" not in label), label


def test_a_shared_network_standardises_by_all_individuals() -> None:
    shared, seen = make(shared=True), torch.randn(K, 200, N) + torch.arange(K)[:, None, None]
    shared.standardise_inputs(seen.mean(1), seen.std(1, correction=0))
    together = seen.flatten(0, 1)
    for k in range(K):
        torch.testing.assert_close(shared.input_mean[k, 0], together.mean(0))
        torch.testing.assert_close(shared.input_sd[k, 0], together.std(0, correction=0))


def test_standardised_inputs_are_those_of_a_network_that_gets_them_so() -> None:
    """By hand, clipped; the flag as it is, a constant component on its own scale."""
    network = StackedQNetwork(("a", "b"), 4, 3, hidden=8, recurrent=False, condition_flag=True)
    generator = torch.Generator().manual_seed(0)
    seen = 3 * torch.randn(2, 5, 6, 4, generator=generator)
    seen[..., -1] = (seen[..., -1] > 0).float()
    mean = torch.randn(2, 4, generator=generator)
    sd = torch.tensor([[0.1, 2.0, 0.0, 5.0], [1.0, 0.5, 0.0, 5.0]])
    given = seen.clone()
    for k in range(2):
        for c in range(3):
            spread = float(sd[k, c]) or 1.0
            given[k, ..., c] = ((seen[k, ..., c] - mean[k, c]) / spread).clamp(-6, 6)
    assert (given[..., 0].abs() == 6).any()
    previous = torch.zeros(2, 5, 6, dtype=torch.int64)
    expected = network(given, previous).values
    network.standardise_inputs(mean, sd)
    torch.testing.assert_close(network(seen, previous).values, expected)


def test_with_a_skip_the_head_sees_what_the_memory_does_not_keep() -> None:
    """With the memory's share of the head set to zero, only a skip lets observations through."""
    for skip in (False, True):
        network = StackedQNetwork(("a",), 3, 3, hidden=4, skip=skip)
        with torch.no_grad():
            assert network.dueling.hidden is not None
            network.dueling.hidden.weight[:, -4:] = 0.0
        seen = torch.randn(1, 7, 2, 3, generator=torch.Generator().manual_seed(0))
        values = network(seen, torch.full((1, 7, 2), 3)).q_values
        assert (values.std(dim=1) > 1e-3).any() == skip


def test_dropout_is_one_mask_per_sequence_and_keeps_the_mean() -> None:
    draws = DropoutDraws(0.25, [1, 2], ("a", "b"))
    masks = draws.masks(2, 500, 16)
    assert masks is not None and masks.shape == (2, 2, 500, 16)
    assert masks.unique().tolist() == pytest.approx([0.0, 4 / 3])
    assert masks.mean() == pytest.approx(1.0, abs=0.02)
    packing = Packing.from_lengths(torch.tensor([[3, 2, 1]]).numpy(), 3)
    few = masks[:, :, :3]
    thinned = packing.unpack(packing.repeat_per_row(few[1]))
    for b, steps in enumerate((3, 2, 1)):
        for t in range(steps):
            assert torch.equal(thinned[:, t, b], few[1, :, b])
    alone = DropoutDraws(0.25, [1, 2], ("b",)).masks(2, 500, 16)
    assert alone is not None and torch.equal(alone[:, 0], masks[:, 1])
    assert DropoutDraws(0.0, [1], ("a",)).masks(2, 3, 4) is None


RULES = {
    "greedy": Acting(), "boltzmann:0.7": Acting.boltzmann(0.7),
    "boltzmann:0.7,0.25,3": Acting.boltzmann([0.7, 0.25, 3.0]),
    "boltzmann:0.7,0.4/0.6/0.35": Acting.boltzmann([0.7, 0.4], thrust=0.6, direction=0.35),
    "epsilon:0.1": Acting.epsilon_greedy(0.1),
}  # fmt: skip


@pytest.mark.parametrize("text", RULES)
def test_a_rule_survives_writing(text: str) -> None:
    rule = RULES[text]
    assert Acting.parse(text) == rule and str(rule) == text
    assert Acting.from_json(json.loads(json.dumps(rule.to_json()))) == rule


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make(()), ""),
        (lambda: make(("prey", "prey")), ""),
        (lambda: make(observation_size=1, condition_flag=True), ""),
        (lambda: make(condition_flag=True, condition_input="memory"), ""),
        (lambda: make(condition_flag=True, condition_input="encoder", treatment_head=True), ""),
        (lambda: make(recurrent=False, skip=True), ""),
        (lambda: Acting("argmax"), "'argmax': choose greedy, boltzmann, epsilon"),  # type: ignore[arg-type]
        (lambda: Acting.boltzmann(0.0), "temperature is 0.0"),
        (lambda: Acting.boltzmann([]), "holds no number"),
        (lambda: Acting.boltzmann([1.0, np.nan]), "temperature is nan"),
        (lambda: Acting.epsilon_greedy(1.5), "epsilon is 1.5"),
        (lambda: Acting.parse("boltzmann"), "write greedy, boltzmann"),
        (lambda: Acting.parse("greedy:1"), "write greedy, boltzmann"),
        (lambda: Acting.parse("epsilon:a"), "write greedy, boltzmann"),
        (lambda: Acting.from_json({"kind": "greedy"}), r"not \['kind'\]"),
        (lambda: Acting.parse("boltzmann:1/0.5"), "write greedy, boltzmann"),
        (lambda: Acting.parse("epsilon:0.1/0.5/0.5"), "write greedy, boltzmann"),
        (lambda: Acting.boltzmann(1.0, direction=0.0), "direction is 0.0"),
        (lambda: Acting.boltzmann([1.0, 2.0]).checked(3, 13), "2 numbers for 3"),
        (lambda: Acting.boltzmann(1.0, thrust=0.5).checked(1, 12), "not 12 actions"),
    ],
)
def test_what_is_no_network_or_rule_is_refused(build: Any, message: str) -> None:
    refuses(message, build)


def test_each_individual_is_sampled_at_its_own_temperature() -> None:
    values = np.array([[2.0, 1.0, 0.0]] * 2)
    draw = np.random.default_rng(0).random(40_000)
    chosen = Acting.boltzmann([0.5, 2.0]).choose(np.tile(values, (20_000, 1)), draw, 2)
    for k, temperature in enumerate((0.5, 2.0)):
        expected = np.exp(values[k] / temperature) / np.exp(values[k] / temperature).sum()
        counts = np.bincount(chosen[k::2], minlength=3) / 20_000
        np.testing.assert_allclose(counts, expected, atol=5 * np.sqrt(0.25 / 20_000))


def odds(thrust: float, direction: float, logits: Any) -> Any:
    """What the rule's formula says, written out action by action."""
    p = np.exp(logits) / np.exp(logits).sum()
    together = [p[12 * m : 12 * m + 12].sum() for m in range(len(p) // 12)] + [p[-1]]
    hard = np.array(together) ** (1 / thrust)
    hard /= hard.sum()
    found = np.empty_like(p)
    for m in range(len(p) // 12):
        way = (p[12 * m : 12 * m + 12] / together[m]) ** (1 / direction)
        found[12 * m : 12 * m + 12] = hard[m] * way / way.sum()
    found[-1] = hard[-1]
    return found


@pytest.mark.parametrize("thrusts", [1, 2])
def test_how_hard_and_which_way_have_temperatures_of_their_own(thrusts: int) -> None:
    logits = np.random.default_rng(thrusts).normal(size=12 * thrusts + 1)
    for thrust, direction in ((1.0, 1.0), (0.5, 1.0), (1.0, 0.3), (0.6, 0.35)):
        sampled = np.exp(two_stage_logits(logits[None], thrust, direction)[0])
        np.testing.assert_allclose(sampled, odds(thrust, direction, logits), rtol=1e-12)
    assert np.isfinite(two_stage_logits(1e4 * logits[None], 0.1, 0.1)).all()


def made(dtype: torch.dtype, device: str = "cpu") -> tuple[StackedGRU, torch.Tensor]:
    """K GRUs with large weights, and their first state."""
    generator = torch.Generator().manual_seed(0)
    layer = StackedGRU(N, H, [generator] * K)
    for parameter in layer.parameters():
        parameter.data = torch.randn(parameter.shape, generator=generator, dtype=dtype) / 2
    state = torch.randn((K, B, H), generator=generator, dtype=dtype) / 2
    return layer.to(device), state.to(device).requires_grad_()


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("packed", [False, True])
def test_gru_equals_torch_in_values_and_all_gradients(
    dtype: torch.dtype, packed: bool, device: str
) -> None:
    """Kernels in single precision on the CPU, PyTorch's own loop elsewhere."""
    single = dtype == torch.float32
    tolerance = dict(rtol=1e-4, atol=3e-6) if single else dict(rtol=1e-9, atol=1e-11)
    layer, state = made(dtype, device)
    arguments = [state, *layer.weights]
    inputs = batch()[0].to(device, dtype).requires_grad_()
    seen = torch.ones(K, T, B, dtype=torch.bool)
    packing = Packing.full(T, B, device)
    if packed:
        packing, seen = Packing.from_lengths(LENGTHS, T, device), valid_steps()
    upstream = torch.randn(K, T, B, H, dtype=torch.float64).to(device, dtype)
    upstream = upstream * seen[..., None].to(device)
    out = packing.unpack(layer(packing.pack(inputs), state, packing))
    final = packing.final(packing.pack(out), state)
    gradients = torch.autograd.grad((out * upstream).sum(), [inputs, *arguments])
    for k in range(K):
        reference = torch_gru(k, *layer.weights)
        one_input = inputs[k].detach().requires_grad_()
        one_state = state[k].detach().unsqueeze(0).requires_grad_()
        with torch.backends.cudnn.flags(enabled=False):  # which rounds to 10 bits (TF32)
            expected, _ = reference(one_input, one_state)
        keep = seen[k].to(device)
        torch.testing.assert_close(out[k][keep], expected[keep], **tolerance)
        (expected * upstream[k]).sum().backward()
        weights = (reference.weight_ih_l0, reference.weight_hh_l0)
        biases = (reference.bias_ih_l0, reference.bias_hh_l0)
        wanted = [one_input.grad, one_state.grad[0], *(w.grad.T for w in weights)]
        wanted += [bias.grad[None] for bias in biases]
        for got, want in zip(gradients, wanted):
            torch.testing.assert_close(got[k], want, **tolerance)
        for b in range(B):
            last = int(seen[k, :, b].sum()) - 1
            want = expected[last, b] if last >= 0 else state[k, b]
            torch.testing.assert_close(final[k, b], want, **tolerance)


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


def test_amplified_inputs_count_without_a_limit_too() -> None:
    network, observations = StackedQNetwork(("a",), 3, 4, recurrent=False), torch.eye(3)
    expected = network(3.0 * observations)
    assert not torch.equal(network(observations), expected)
    network.amplify_inputs([0, 1, 2], np.array([3.0]))
    torch.testing.assert_close(network(observations), expected)
