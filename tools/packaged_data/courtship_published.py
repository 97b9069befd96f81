"""What the paper says of its courtship recordings, and the constants of the generator.

Fujii et al., "Fly dataset", "Newt dataset" and Table 1. The paper has no numbers for the
distribution of speeds; its histograms are "dominated by near-zero velocity". The shapes were
printed by ``python -m tools.packaged_data.courtship fit fly --data DATA_DIR`` (and ``newt``).
"""

from __future__ import annotations

from dataclasses import dataclass

from tools.packaged_data.courtship_behaviour import Behaviour
from tools.packaged_data.courtship_shapes import Shape


@dataclass(frozen=True, kw_only=True)
class Published:
    """Statistics of one species' episodes in the paper."""

    episodes: int
    shortest: float  # [s]
    longest: float  # [s]
    total: float  # [s]
    touch_rates: tuple[float, float]  # by male_0, by male_1
    splits: tuple[int, int, int]  # train, val, test


@dataclass(frozen=True, kw_only=True)
class Starts:
    """Where episodes start; chosen by hand for the published durations and touch rates."""

    gap: tuple[float, float]  # males start so far from the female [arena unit]
    first_nearer: float  # share of the starts in which male_0 is the nearer
    moving: float  # share of individuals on the way towards their focus, the others are at rest
    far: tuple[float, float]  # the gap before the longest episode, where no usual one is as long
    head_on: bool  # before the shortest, as it is too short for the published locomotion


PUBLISHED = {
    "fly": Published(
        episodes=107, shortest=0.4, longest=47.8, total=425.6, touch_rates=(0.720, 0.280),
        splits=(84, 13, 10),
    ),
    "newt": Published(
        episodes=280, shortest=2.5, longest=50.0, total=12141.6, touch_rates=(0.507, 0.442),
        splits=(240, 20, 20),
    ),
}  # fmt: skip

SHAPES = {
    "fly": Shape(
        pause=(0.3, 0.3, 0.3, 0.4, 0.5, 0.7, 1.0, 1.6, 2.7, 4.5, 14.102),
        move=(0.3, 0.5, 0.8, 1.2, 1.8, 2.6, 3.5, 4.8, 7.0, 10.8, 25.5),
        speed=(0.155, 0.228, 0.269, 0.301, 0.33, 0.358, 0.387, 0.42, 0.46, 0.52, 0.681),
        top=0.651,
        turning=1.182,
        source="fly_groups12/tracks_24fps_int16.npz",
    ),
    "newt": Shape(
        pause=(0.3, 0.3, 0.4, 0.4, 0.5, 0.7, 0.8, 1.1, 1.5, 2.7, 9.5),
        move=(0.3, 0.5, 1.1, 2.1, 3.3, 4.8, 6.9, 9.7, 14.6, 25.26, 89.176),
        speed=(0.126, 0.21, 0.279, 0.332, 0.377, 0.416, 0.449, 0.49, 0.546, 0.636, 0.821),
        top=0.529,
        turning=0.721,
        source="termite_tandem/tracks_30fps_int16.npz",
    ),
}

BEHAVIOURS = {
    "fly": Behaviour(
        peak=0.2,
        spread=0.2,
        pause=(1.5, 1.5),
        courting=(0.6, 0.15, 0.05, 0.0, 0.0, 0.0, 0.0),
        female=(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
        alarm=0.6,
        wall_margin=0.05,
    ),
    "newt": Behaviour(
        peak=0.05,
        spread=0.08,
        pause=(1.9, 2.3),
        courting=(0.6, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0),
        female=(0.6, 0.2, 0.0, 0.0, 0.0, 0.0, 0.0),  # she comes, or nobody would arrive in time
        alarm=0.0,
        wall_margin=0.05,
    ),
}

STARTS = {
    "fly": Starts(gap=(0.32, 0.48), first_nearer=0.97, moving=0.7, far=(1.5, 1.8), head_on=False),
    "newt": Starts(gap=(1.47, 1.53), first_nearer=0.6, moving=0.0, far=(1.5, 1.8), head_on=True),
}
