"""How many thrust magnitudes a simulator needs, until a classifier hardly recognises its motion.

Closed-loop tracking follows the recordings with the 12 directions and M magnitudes. How well a
classifier tells the result from the recordings (area under its ROC curve) estimates the floor of
simulations with these magnitudes. It is no bound: tracking takes the nearest action of each step
and may be recognised by that, where a policy that acts like the animal would not be.
"""

from collections.abc import Sequence

import numpy as np

from animarl_algos.evaluation.classifier import PART, classify, tracked_rollouts, window_features
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing, resting_step
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.learner.progress import progress_display
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.locomotion import Locomotion

CANDIDATES = (1, 2, 3, 5, 8)
GOOD_FLOOR = 2 / 3  # needs no further magnitude
MIN_IMPROVEMENT = 0.05  # by which the floor must fall to be worth more actions
MAX_INTERVAL_WIDTH = 1 / 3  # a wider interval of the floor decides nothing
DEFAULT_THRUSTS = 3  # then: a guess between one (artificial chasers) and five (moths, flies)
MIN_EPISODES = 10  # with fewer, parts of episodes are dealt to the classifier's folds


def tracking_floor(
    seen: Demonstrations,
    locomotion: Sequence[Locomotion],
    *,
    arena: Arena | None = None,
    seed: int = 0,
) -> Interval:
    """Return how well a classifier tells closed-loop tracking of ``seen`` from it; 0.5: not at all.

    Both sides are at the scale at which positions were stored and filtered. ``arena`` has the walls
    that tracking meets, by default those of the world that ``seen`` makes, as in the verdict.
    """
    prepared = Prepared(seen, comparison_smoothing(seen))
    walls = arena_of(seen) if arena is None else arena
    tracked = tracked_rollouts(seen, track(seen, locomotion, walls))
    rest = resting_step(Rollouts.from_demonstrations(seen))
    block = PART if seen.num_episodes < MIN_EPISODES else None
    own, other = (
        window_features(each, seen.arena, block=block, still=rest)
        for each in (prepared.recorded, prepared.filtered(tracked))
    )
    if block is None:
        own, other = own.by_recording(seen), other.by_recording(seen)
    return classify(own, other, np.random.default_rng(seed), deals=1).auc


def choose_thrusts(demos: Demonstrations, *, seed: int = 0) -> tuple[int, str]:
    """Return the number of magnitudes for a simulator, and the reason in a few words.

    Candidates are tried on the training episodes (or all, without any) until the floor is at most
    ``GOOD_FLOOR``. The fewest are taken whose floor is within ``MIN_IMPROVEMENT`` of the lowest. If
    the episodes are too few to estimate the floor, ``DEFAULT_THRUSTS`` are taken.
    """
    seen = demos.select(split="train") if (demos.split == "train").any() else demos
    floors: dict[int, float] = {}
    with progress_display("choice of thrusts", "candidate", len(CANDIDATES)) as bar:
        for thrusts in CANDIDATES:
            floor = tracking_floor(seen, joint_locomotion(seen, thrusts), seed=seed)
            if np.isnan(floor.high - floor.low) or floor.high - floor.low > MAX_INTERVAL_WIDTH:
                return DEFAULT_THRUSTS, "a guess, since these are too few to tell"
            floors[thrusts] = floor.estimate
            bar.update()
            if floors[thrusts] <= GOOD_FLOOR:
                break
    lowest = min(floors.values())
    chosen = next(m for m, floor in floors.items() if floor <= lowest + MIN_IMPROVEMENT)
    return chosen, (
        f"the fewest whose floor ({floors[chosen]:.2f}) is within {MIN_IMPROVEMENT:g} of the "
        f"lowest ({lowest:.2f}) of {', '.join(map(str, floors))}"
    )
