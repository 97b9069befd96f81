"""The stacked GRU equals PyTorch's for each individual, and packing loses no step."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from sequences import LENGTHS, B, H, K, N, T, batch, torch_gru, valid_steps

from animarl_algos.networks.kernels import tanh_float32
from animarl_algos.networks.layers import Packing, StackedGRU


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
            want = expected[last, b] if last >= 0 else state[k, b]
            torch.testing.assert_close(final[k, b], want, **tolerance)


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
