"""A filament plume: 1 Hz puffs carried downwind, spreading and thinning out (Farrell et al. 2002).

Frame. The source lies at the origin of the arena frame; the air flows towards +x, so upwind is -x.

Every puff is released as ``filaments_per_puff`` filaments. Filament j leaves the source at time
``s_j``, travels at its own speed and direction, and grows like a diffusing Gaussian ball::

    a = t - s_j                                         age
    x_j = U_j a,  y_j = y0_j + v_j a,  z_j = z0_j + w_j a
    R_j^2 = R_0^2 + growth a
    c(x, y) = sum_j (R_0 / R_j)^3 exp(-((x - x_j)^2 + (y - y_j)^2 + z_j^2) / (2 R_j^2))

in units of the concentration in the middle of a fresh filament; the antenna is hit where c exceeds
``threshold``. (x, y) is the plane of the moth, z the height of a filament above it: filaments that
pass above or below leave gaps. Within a puff, release times s_j are gamma-distributed. Directions
have a part that all filaments of a puff share and that persists over ``meander_time``, and a part
of their own; the latter, and the offsets (y0, z0) at the source, are heavy-tailed (Student's t).

References
----------
Farrell, Murlis, Long, Li and Carde (2002), Filament-based atmospheric dispersion model to achieve
short time-scale structure of odor plumes, Environmental Fluid Mechanics 2: 143-169.
"""

from __future__ import annotations

import functools
import json
import math
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.compiling import jit
from animarl_envs.errors import InputError
from animarl_envs.settings import Count, NotNegative, Positive, check_fields

REACH = 3.0  # a filament is followed this many radii R from its centre
TAIL = 3  # degrees of freedom of Student's t
SHAPE = 3.0  # of the gamma distribution of release times: a quick rise and a longer tail
LATEST = 2.0  # no filament is released later than this within its puff [s]
SLOWEST = 0.2  # no filament travels slower than this share of the advection speed


@dataclass(frozen=True, kw_only=True)
class FilamentModel:
    """Constants of the plume model; :meth:`fitted` gives those of the recorded plumes.

    Raises InputError if a constant is out of its range.
    """

    puff_rate: Positive  # [Hz]
    release_duration: NotNegative  # mean of the gamma-distributed release times in a puff [s]
    filaments_per_puff: Count
    advection_speed: Positive  # U [m/s]
    speed_spread: NotNegative  # standard deviation of U_j / U [1]
    source_spread: NotNegative  # scale of y0_j and z0_j [m]
    direction_spread: NotNegative  # scale of v_j / U and w_j / U, a filament's own part [rad]
    meander_spread: NotNegative  # standard deviation of the part that a puff shares [rad]
    flatness: NotNegative  # z0_j and w_j are smaller than y0_j and v_j by this factor
    meander_time: Positive  # over which the shared part persists [s]
    initial_radius: Positive  # R_0 [m]
    growth: NotNegative  # dR^2 / dt [m^2/s]
    threshold: Positive  # in units of the fresh filament's central concentration
    extent: Positive  # the plume is cut here, x [m]; the recorded fields ended there
    half_width: Positive  # ... and here, |y| [m]
    cell: Positive  # grid [m]
    frame_rate: Positive  # [Hz]
    period: Positive  # the sequence repeats after this time [s]

    def __post_init__(self) -> None:
        check_fields(self, "plume constant ")
        if abs(self.period * self.puff_rate - self.num_puffs) > 1e-9:
            raise InputError(
                f"plume period {self.period} s holds {self.period * self.puff_rate:g} puffs: "
                "choose a period with a whole number of them"
            )

    @classmethod
    @functools.cache
    def fitted(cls) -> FilamentModel:
        """Return the model fitted by ``tools.packaged_data.plume_fit``, from ``plume.json``."""
        text = resources.files("animarl_envs.worlds.plume").joinpath("plume.json").read_text()
        return cls(**json.loads(text)["constants"])

    @property
    def num_puffs(self) -> int:
        """Number of puffs in the sequence."""
        return round(self.period * self.puff_rate)

    @property
    def grid(self) -> tuple[int, int, float, float]:
        """Rows (y) and columns (x) of the grid, and x and y of the first cell's centre [m]."""
        margin = 4  # cells upwind of the source and beyond the edges, for the antenna's radius
        columns = math.ceil(self.extent / self.cell) + 2 * margin
        rows = 2 * (math.ceil(self.half_width / self.cell) + margin) + 1
        return rows, columns, -margin * self.cell, -(rows // 2) * self.cell

    @functools.lru_cache(maxsize=16)  # noqa: B019
    def release(self, pattern: int) -> Floats:
        """Return the filaments of one pattern, ``(puffs, filaments, 6)``.

        They are s_j [s], U_j, v_j, w_j [m/s], y0_j, z0_j [m]. The same pattern number always gives
        the same filaments, one array that is not to be changed; the sequence joins up with itself
        after ``period``.
        """
        rng = np.random.default_rng([pattern, 0x706C756D65])
        puffs, each = self.num_puffs, self.filaments_per_puff
        shared = np.stack([self._meander(rng), self._meander(rng)], axis=-1)
        plane = np.array([1.0, self.flatness])  # y and z
        offset = self.source_spread * plane * rng.standard_t(TAIL, (puffs, each, 2))
        own = self.direction_spread * rng.standard_t(TAIL, (puffs, each, 2))
        direction = plane * (self.meander_spread * shared[:, None] + own)
        speed = 1.0 + self.speed_spread * rng.standard_normal((puffs, each))
        speed = self.advection_speed * np.maximum(speed, SLOWEST)
        later = rng.gamma(SHAPE, self.release_duration / SHAPE, (puffs, each))
        start = np.arange(puffs)[:, None] / self.puff_rate + np.minimum(later, LATEST)
        return np.concatenate(
            [start[..., None], speed[..., None], self.advection_speed * direction, offset], axis=-1
        )

    def _meander(self, rng: np.random.Generator) -> Floats:
        """Return first-order autoregressive noise of unit variance around the circle of puffs."""
        memory = math.exp(-1.0 / (self.meander_time * self.puff_rate))
        frequency = np.exp(-2j * np.pi * np.fft.rfftfreq(self.num_puffs))
        gain = math.sqrt(1.0 - memory**2) / (1.0 - memory * frequency)
        noise = np.fft.rfft(rng.standard_normal(self.num_puffs)) * gain
        return np.asarray(np.fft.irfft(noise, self.num_puffs))

    def concentration(self, pattern: int, time: float) -> NDArray[np.float32]:
        """Return the concentration at one time [s], ``(rows, columns)``, row 0 at the lowest y."""
        rows, columns, _, _ = self.grid
        out = np.zeros((rows, columns), dtype=np.float32)
        paint(out, time, self.release(pattern), *self.kernel_constants())
        return out

    def kernel_constants(self) -> tuple[float, ...]:
        """Return the arguments of :func:`paint` after the filaments."""
        _, _, x0, y0 = self.grid
        oldest = self.extent / (SLOWEST * self.advection_speed) + LATEST
        return (
            self.puff_rate,
            math.ceil(oldest * self.puff_rate) + 1,
            self.initial_radius,
            self.growth,
            self.extent,
            self.cell,
            x0,
            y0,
        )


@jit
def paint(field, time, filaments, rate, oldest, radius, growth, extent, cell, x0, y0):  # type: ignore[no-untyped-def]
    """Add the concentration at ``time`` to ``field`` (rows, columns).

    Returns the rows and columns that were touched: first row, one past the last, first column, one
    past the last.
    """
    rows, columns = field.shape
    puffs, each, _ = filaments.shape
    period = puffs / rate
    rightmost = min(columns - 1, math.floor((extent - x0) / cell))
    across = np.empty(columns, dtype=np.float32)
    bottom, top, left, right = rows, 0, columns, 0
    newest = math.floor(time * rate)
    for puff in range(newest - min(oldest, puffs) + 1, newest + 1):
        for j in range(each):
            age = (time - filaments[puff % puffs, j, 0]) % period
            centre_x = filaments[puff % puffs, j, 1] * age
            square = radius * radius + growth * age
            reach = REACH * math.sqrt(square)
            if centre_x - reach > extent:
                continue
            centre_y = filaments[puff % puffs, j, 4] + filaments[puff % puffs, j, 2] * age
            height = filaments[puff % puffs, j, 5] + filaments[puff % puffs, j, 3] * age
            if abs(height) > reach:
                continue
            c0 = max(0, math.ceil((centre_x - reach - x0) / cell))
            c1 = min(rightmost, math.floor((centre_x + reach - x0) / cell)) + 1
            r0 = max(0, math.ceil((centre_y - reach - y0) / cell))
            r1 = min(rows - 1, math.floor((centre_y + reach - y0) / cell)) + 1
            strength = (radius * radius / square) ** 1.5 * math.exp(-0.5 * height * height / square)
            for column in range(c0, c1):
                offset = x0 + column * cell - centre_x
                across[column] = strength * math.exp(-0.5 * offset * offset / square)
            for row in range(r0, r1):
                offset = y0 + row * cell - centre_y
                share = np.float32(math.exp(-0.5 * offset * offset / square))
                for column in range(c0, c1):
                    field[row, column] += across[column] * share
            bottom = min(bottom, r0)
            top = max(top, r1)
            left = min(left, c0)
            right = max(right, c1)
    return bottom, top, left, right
