"""Departures of DQDIL-PT from the settings that the paper published, each tried in the joint world.

A weight moves by about the learning rate in an update of Adam, at most, and pretraining on few
demonstrations has few updates. So the rate of pretraining comes first: it is tried for the paper's
loss, for the cross-entropy of labels, and for that with the acting rule chosen on training starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from animarl_algos.learner.presets import learner_preset
from animarl_algos.runs.run_settings import CHOSEN, RunSettings
from animarl_envs import environment_id

DEPARTED: Final = "departed"
DEPARTED_STEPS = 20_000
RATES = (1e-5, 1e-4, 1e-3, 1e-2)
LARGE_RATES = RATES[2:]
PUBLISHED: Final = "as published"
CROSS_ENTROPY: Final = "cross-entropy of labels"
DISTANCE: Final = "distances of actions"


@dataclass(frozen=True)
class Departure:
    """Settings of the learner that go over the published ones, and how it acts then."""

    overrides: Mapping[str, Any] = field(default_factory=dict)
    labelled: bool = False
    acting: str | None = None

    def changed(self, settings: RunSettings) -> RunSettings:
        """Return the settings of a run of preset ``paper`` with this departure alone."""
        own = dict(self.overrides)
        if self.labelled:
            default = learner_preset(settings.algo, environment_id(settings.species))
            labels = {k: v for k, v in default.env_kwargs.items() if k.startswith("label")}
            own |= {"offline_loss": "cloning", "env_kwargs": labels}
        return settings.changed(
            overrides=settings.overrides | own, acting=self.acting or settings.acting
        )


LOSSES = {
    DISTANCE: Departure(),
    CROSS_ENTROPY: Departure(labelled=True),
    f"{CROSS_ENTROPY}, chosen acting": Departure(labelled=True, acting=CHOSEN),
}
"""The lines of the figure."""


def at_rate(loss: str, rate: float) -> str:
    """Return the name of a departure."""
    return f"{loss}, rate {rate:g}"


ALONE = {
    PUBLISHED: Departure(),
    CROSS_ENTROPY: LOSSES[CROSS_ENTROPY],
    "300 epochs": Departure({"offline_epochs": 300}),
    "penalties in units of their mean": Departure(
        {"offline_scaled_penalties": True, "offline_alpha": 1.2}
    ),
    "discount 0.9 offline": Departure({"offline_gamma": 0.9}),
    "rate 0.001 online": Departure({"learning_rate": 1e-3}),
    "epsilon 0.05 online": Departure(
        {"exploration_initial_eps": 0.05, "exploration_final_eps": 0.05}
    ),
    "reward by closeness": Departure({"env_kwargs": {"dtw": "closeness"}}),
    "chosen acting": Departure(acting=CHOSEN),
}
DEPARTURES = ALONE | {
    at_rate(loss, rate): Departure({"offline_learning_rate": rate}, own.labelled, own.acting)
    for loss, own in LOSSES.items()
    for rate in RATES
}
"""By what the page calls them."""
SINGLE = (*ALONE, *(at_rate(DISTANCE, rate) for rate in LARGE_RATES))
"""Published settings and single departures from them."""
TOGETHER = tuple(at_rate(loss, rate) for loss in LOSSES if loss != DISTANCE for rate in LARGE_RATES)
"""Departures of two and of three settings."""


def setting_of(departure: str) -> str:
    """Return the setting of a departure's cells, which stands in the names of their records."""
    return f"{DEPARTED}-{departure.replace(',', '').replace(' ', '-')}"
