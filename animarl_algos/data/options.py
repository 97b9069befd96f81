"""Options of :class:`~animarl_algos.data.vec_env.SlotVecEnv`: its own, scenario's, species'."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

SCENARIO_OPTIONS = ("condition", "start", "observation_noise", "observation_delay")
OWN_OPTIONS = (
    "split", "focal", "condition_flag", "cue", "dtw", "labels", "label_width", "label_horizon",
)  # fmt: skip


def species_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that change the species."""
    return {k: v for k, v in options.items() if k not in (*SCENARIO_OPTIONS, *OWN_OPTIONS)}
