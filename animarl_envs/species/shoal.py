"""Twelve fish that swim together in a round tank.

Nobody is pursued. ``shoaling_reward=True`` rewards a fish for time within a body length (the
contact radius) of another. The packaged demonstrations are synthetic, after Couzin et al. (2002):
see ``tools/packaged_data/shoal.py``. Damping, thrust and magnitudes are fitted to them (joint fit
of the training split). An arena unit is 10 body lengths.
"""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.chase import ChaseSpecies

FISH = tuple(f"fish_{i}" for i in range(12))

SHOAL = ChaseSpecies(
    name="shoal",
    title="Shoaling fish",
    individuals=FISH,
    locomotion=(Locomotion(0.074, 0.806, (1.55, 0.99, 0.53)),) * len(FISH),
    arena=Arena("disc", size=1.0, boundary=1.1, rebound=True),
    contact_radius=0.1,
    dt=0.1,
    time_limit=200,
    free=True,
    neighbours=8,
    senses_past=True,
    senses_compass=False,
    recording=Recording(frame_rate=10.0, onset_threshold=0.05),
    source="Couzin, Krause, James, Ruxton & Franks 2002, Journal of Theoretical Biology 218, 1-11",
)
