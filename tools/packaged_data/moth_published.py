"""What the paper says of its silkmoths."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """From the sections "Silkmoth dataset" and "Counterfactual ..."."""

    episodes: int = 60
    reached_full: float = 1.000
    reached_reduced: float = 0.633
    shortest: float = 9.0  # [s]
    total: float = 6611.5  # [s]
    path_difference: tuple[float, float] = (1.340, 2.216)
    """Mean path with reduced senses less that with full ones, 95 % interval; its unit is not given
    and taken for metres."""

    @property
    def mean_duration(self) -> float:
        """[s]"""
        return self.total / self.episodes


PUBLISHED = Published()
