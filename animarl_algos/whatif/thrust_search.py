"""Search of the thrust at which a simulated individual reaches a wanted mean speed."""

import math

import numpy as np

CLOSE_ENOUGH = 0.02  # relative error of an achieved speed
USUAL_SLOPE = 0.7  # log of the achieved speed per log of the thrust
LONGEST_STEP = 1.4  # log of the thrust, while the wanted speed is not yet bracketed
NARROWEST = 1e-3  # bracket of log thrust, below which the speed jumps over the wanted one
LIMITS = (1 / 8, 8.0)  # factors on the thrust
SLOWEST = 1e-12  # an animal that rests [arena unit / s]

Try = tuple[float, float]  # logarithms of a factor on the thrust and of the speed that it gave


class ThrustSearch:
    """Bracket a wanted speed between two thrusts, then narrow the bracket.

    Speed rises with thrust, but not evenly: a policy may rest up to a thrust and run beyond it. So
    no line through all tries is trusted. The bracket is cut by turns where a line between its ends
    has the wanted speed, and in its middle.

    Attributes
    ----------
    factor
        The factor on the thrust that is to be tried next.
    """

    def __init__(self, wanted: float, usual: float) -> None:
        self._wanted, self._speed = math.log(wanted), math.nan
        self._low: Try | None = None
        self._high: Try | None = None
        self._step, self._halve = 0.0, False
        self.factor = float(np.clip(wanted / usual, *LIMITS))

    @property
    def is_met(self) -> bool:
        """Whether the last try came close enough to the wanted speed."""
        return abs(self._speed - self._wanted) <= CLOSE_ENOUGH

    def record(self, speed: float) -> None:
        """Record the speed that the present factor gave."""
        here = math.log(self.factor), math.log(max(speed, SLOWEST))
        self._speed = here[1]
        if here[1] < self._wanted:
            self._low = here
            if self._high is not None and self._high[0] <= here[0]:
                self._high = None
        else:
            self._high = here
            if self._low is not None and self._low[0] >= here[0]:
                self._low = None

    def advance(self) -> bool:
        """Choose the next factor; return False where none is left that could help."""
        if self._low is not None and self._high is not None:
            (left, slow), (right, fast) = self._low, self._high
            if right - left < NARROWEST:
                return False
            share = 0.5 if self._halve else (self._wanted - slow) / (fast - slow)
            self._halve = not self._halve
            self.factor = math.exp(left + min(max(share, 0.1), 0.9) * (right - left))
            return True
        miss = self._wanted - self._speed
        self._step = min(max(abs(miss) / USUAL_SLOPE, 2 * self._step), LONGEST_STEP)
        before = self.factor
        self.factor = float(np.clip(before * math.exp(math.copysign(self._step, miss)), *LIMITS))
        return self.factor != before

    def describe_failure(self, scale: float) -> str:
        """Return what the nearest thrusts give; ``scale`` is the shown unit per arena unit."""
        ends = [one for one in (self._low, self._high) if one is not None]
        given = (f"x{math.exp(x):.4g} gives {math.exp(y) * scale:.3g}" for x, y in ends)
        return " and ".join(given)
