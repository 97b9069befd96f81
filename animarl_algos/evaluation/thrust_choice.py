"""How many thrust magnitudes recordings ask for: as many as a classifier needs to be fooled.

Closed-loop tracking follows the recordings with the 12 directions and M magnitudes. What tells it
from them (area under the ROC curve of a classifier) estimates the floor of simulations with these
magnitudes. It is no bound: tracking takes the nearest action of each step, and may give itself away
by that where a policy that acts like the animal would not.
"""

from collections.abc import Sequence

import numpy as np

from animarl_algos.evaluation.classifier import PART, classify, tracked_rollouts, window_features
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing, resting_step
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.custom_species import arena_of
from animarl_envs.fitting.joint import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.locomotion import Locomotion

TRIED = (1, 2, 3, 5, 8)
LOW = 2 / 3  # a floor that needs no further magnitude
GAIN = 0.05  # by which the floor must fall to be worth more actions
UNSURE = 1 / 3  # a wider interval of the floor tells nothing: it reaches from not told to told
RECORDED = 3  # then a guess between one (artificial chasers) and five (recorded moths, flies)
FEW = 10  # with fewer demonstrations, parts of them are dealt to the classifier's folds


def tracking_floor(
    seen: Demonstrations,
    locomotion: Sequence[Locomotion],
    *,
    arena: Arena | None = None,
    seed: int = 0,
) -> Interval:
    """How well closed-loop tracking of ``seen`` is told from it: 0.5 where it is not.

    Both sides are at the scale at which positions were stored and filtered. ``arena`` has the walls
    that tracking meets, by default those of the world that ``seen`` makes, as in the verdict.
    """
    prepared = Prepared(seen, comparison_smoothing(seen))
    walls = arena_of(seen) if arena is None else arena
    tracked = tracked_rollouts(seen, track(seen, locomotion, walls))
    rest = resting_step(Rollouts.from_demonstrations(seen))
    block = PART if seen.num_episodes < FEW else None
    own, other = (
        window_features(each, seen.arena, block=block, still=rest)
        for each in (prepared.recorded, prepared.filtered(tracked))
    )
    if block is None:
        own, other = own.by_recording(seen), other.by_recording(seen)
    return classify(own, other, np.random.default_rng(seed), deals=1).auc


def choose_thrusts(demos: Demonstrations, *, seed: int = 0) -> tuple[int, str]:
    """The number of magnitudes for a simulator, and what decided it, in a few words.

    More are tried on the training episodes (all, if there are none) until the floor is at most
    ``LOW``, and the fewest are taken from which the floor does not fall by another ``GAIN``. Where
    the episodes are too few to say what the floor is, ``RECORDED`` are taken: one would be what
    artificial chasers have, and is no safer a guess.
    """
    seen = demos.select(split="train") if (demos.split == "train").any() else demos
    floors: dict[int, float] = {}
    for thrusts in TRIED:
        floor = tracking_floor(seen, joint_locomotion(seen, thrusts), seed=seed)
        if np.isnan(floor.high - floor.low) or floor.high - floor.low > UNSURE:
            return RECORDED, "a guess, since these are too few to tell"
        floors[thrusts] = floor.estimate
        if floors[thrusts] <= LOW:
            break
    lowest = min(floors.values())
    chosen = next(m for m, floor in floors.items() if floor <= lowest + GAIN)
    return chosen, (
        f"the fewest whose floor ({floors[chosen]:.2f}) is within {GAIN:g} of the lowest "
        f"({lowest:.2f}) of {', '.join(map(str, floors))}"
    )
