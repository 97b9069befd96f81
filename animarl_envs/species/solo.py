"""A larva that crawls alone in the open, by runs and turns.

Nobody is pursued, and there is no reward. The packaged demonstrations are synthetic, after Davies
et al. (2015): see ``tools/packaged_data/larva.py``. Damping, thrust and magnitudes are fitted to
them (joint fit of the training split). An arena unit is 20 mm.
"""

from animarl_envs.arena import Arena
from animarl_envs.locomotion import Locomotion
from animarl_envs.species.base import Recording
from animarl_envs.species.chase import ChaseSpecies

SOLO = ChaseSpecies(
    name="solo",
    title="Crawling larva",
    individuals=("larva",),
    locomotion=(Locomotion(0.081, 0.088, (2.23, 1.11, 0.56)),),
    arena=Arena("open", size=1.0),
    contact_radius=0.01,
    dt=0.2,
    time_limit=300,
    free=True,
    senses_past=True,
    senses_compass=False,
    recording=Recording(frame_rate=5.0, onset_threshold=0.01),
    source="Davies, Louis & Webb 2015, PLoS Computational Biology 11(11), e1004606",
)
