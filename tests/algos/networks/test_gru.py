"""The stacked GRU equals PyTorch's for each individual, and packing loses no step."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sequences import LENGTHS, B, H, K, N, T, batch, torch_gru, valid_steps

from animarl_algos.networks import layers
from animarl_algos.networks.kernels.gru_kernels import tanh_float32
from animarl_algos.networks.layers import GRUFunction, Packing
from animarl_envs.errors import InputError


def gru_arguments(dtype: torch.dtype, device: str = "cpu") -> list[torch.Tensor]:
    """First state, weights of input and state, biases of input and state."""
    generator = torch.Generator().manual_seed(0)
    shapes = [(K, B, H), (K, N, 3 * H), (K, H, 3 * H), (K, 1, 3 * H), (K, 1, 3 * H)]
    draws = [torch.randn(s, generator=generator, dtype=torch.float64) / 2 for s in shapes]
    return [d.to(device, dtype).requires_grad_() for d in draws]


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)])
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
    out = packing.unpack(GRUFunction.apply(packing.pack(inputs), *arguments, packing))
    final = packing.final(packing.pack(out), arguments[0])
    gradients = torch.autograd.grad((out * upstream).sum(), [inputs, *arguments])
    for k in range(K):
        reference = torch_gru(k, *arguments[1:])
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
    assert torch.autograd.gradcheck(lambda *a: GRUFunction.apply(*a, packing), arguments)


def test_kernels_equal_the_tensor_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = gru_arguments(torch.float32)
    packing = Packing.from_lengths(LENGTHS, T)
    inputs = packing.pack(batch()[0]).requires_grad_()
    upstream = torch.randn(K, inputs.shape[1], H)

    def results() -> tuple[torch.Tensor, ...]:
        out = GRUFunction.apply(inputs, *arguments, packing)
        return (out, *torch.autograd.grad(out, [inputs, *arguments], upstream))

    compiled = results()
    monkeypatch.setattr(layers, "runs_compiled", lambda tensor: False)
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
