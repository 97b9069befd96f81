"""The velocity transition as kernels call it; see :mod:`animarl_envs.locomotion`.

It stands apart so that importing the package, which needs the parameters alone, leaves numba out.
"""

import numba as nb


@nb.njit(inline="always")
def next_velocity(velocity, acceleration, damping, thrust, dt):  # type: ignore[no-untyped-def]
    """One component of ``v' = (1 - d) v + u a dt`` (paper, eq. 1); the position follows with v'."""
    return (1.0 - damping) * velocity + thrust * acceleration * dt
