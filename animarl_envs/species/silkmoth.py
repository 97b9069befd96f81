"""A silkmoth searching an odour source (paper, "Silkmoth dataset").

The published d and u imply a terminal speed of 0.050 m/s, but recorded moths stay below 0.036 m/s.
They are the defaults because the packaged demonstrations use them. Fit your own.

The packaged demonstrations are of a programmed moth, and its body points where it walks. Recorded
moths also walk sideways: ``turning=RECORDED_TURNING`` simulates this. If your own recordings have
headings, turning is fitted to them.

The packaged demonstrations are synthetic, not recorded: see ``docs/data/packaged_silkmoth.md``.
"""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.search import SearchSpecies
from animarl_envs.species.turning import Turning

RECORDED_TURNING = Turning(persistence=0.231, gain=0.779, slip=0.308, speed=0.00882)
"""Fitted to the headings of all 24 public runs of the set-up of Yamada et al. (2021); figures and
command are in ``docs/plume.md``."""

SILKMOTH = SearchSpecies(
    name="silkmoth",
    title="Silkmoth and odour source",
    individuals=("moth",),
    locomotion=(Locomotion(0.208, 0.021),),
    arena=Arena("open", size=0.35),
    contact_radius=0.05,
    dt=0.5,
    time_limit=600,
    warmup=10,
    conditions=("full senses", "wind and vision blocked"),
    recording=Recording(frame_rate=30.0, onset_threshold=0.01),
    bodies=("moth",),
    source="Fujii et al., Silkmoth dataset and Table 1; Yamada et al. 2021, eLife",
)
