"""The velocity transition as kernels call it: :func:`animarl_envs.locomotion.next_velocity`.

It stands apart so that importing the package, which needs the parameters alone, leaves numba out.
Fits and worlds use it alike, so it imports nothing above :mod:`animarl_envs.locomotion`.
"""

from typing import Any

import numba as nb

from animarl_envs import locomotion

next_velocity: Any = nb.njit(inline="always")(locomotion.next_velocity)
"""One component of ``v' = (1 - d) v + u a dt``."""
