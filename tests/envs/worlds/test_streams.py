"""The fast functions of kernels beside NumPy's."""

from typing import Any

import numpy as np

from animarl_envs.worlds.streams import angle_of, log_of, tanh_of, tanh_tripled

NUMBERS = np.concatenate([np.linspace(-12, 12, 4001), np.logspace(-12, 1, 500)]).astype(np.float32)


def computed(function: Any, *numbers: Any) -> Any:
    """What a kernel's function gives for each number, in Python's float32."""
    return np.vectorize(function.py_func, otypes=[np.float32])(*numbers).astype(float)


def test_tanh_is_close_odd_and_never_beyond_one() -> None:
    found = computed(tanh_of, NUMBERS)
    np.testing.assert_allclose(found, np.tanh(NUMBERS.astype(float)), rtol=4e-7)
    assert np.array_equal(computed(tanh_of, -NUMBERS), -found)
    assert np.abs(found).max() <= 1.0
    tripled = computed(tanh_tripled, found.astype(np.float32))
    np.testing.assert_allclose(tripled, np.tanh(3.0 * NUMBERS.astype(float)), rtol=2e-6)
    assert np.abs(tripled).max() <= 1.0


def test_logarithm_and_angle_are_close() -> None:
    positive = np.abs(NUMBERS[NUMBERS != 0.0])
    np.testing.assert_allclose(
        computed(log_of, positive), np.log(positive.astype(float)), atol=2e-6
    )
    turns = np.linspace(-np.pi, np.pi, 2001)
    x, y = np.cos(turns).astype(np.float32), np.sin(turns).astype(np.float32)
    exact = np.arctan2(y.astype(float), x.astype(float))
    np.testing.assert_allclose(computed(angle_of, x, y), exact, atol=5e-7)
    assert computed(angle_of, np.float32(0.0), np.float32(0.0)) == 0.0
