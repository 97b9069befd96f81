"""How often: what has passed since the last updates, and how many are due."""

from __future__ import annotations

from dataclasses import dataclass

from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import should_collect_more_steps

AS_MANY_AS_STEPS = -1
"""Value of ``gradient_steps``, as in stable-baselines3."""


@dataclass
class Pace:
    """Counts steps and episodes, and says when to learn from the memory.

    Attributes
    ----------
    steps, episodes
        Steps of every copy, and finished episodes of all copies, since the last updates.
    updates_due
        What is left of an update after the whole ones: ``updates_per_episode`` may be fractional.
    since_target
        Steps of the world or episodes since the target network took over weights.
    """

    steps: int = 0
    episodes: int = 0
    updates_due: float = 0.0
    since_target: int = 0

    def restart(self) -> None:
        """Nothing has been collected since the last updates."""
        self.steps = self.episodes = 0

    def passed(self, episodes: int) -> None:
        """One step of every copy, with which ``episodes`` of them have finished."""
        self.steps += 1
        self.episodes += episodes

    def collecting(self, frequency: TrainFreq) -> bool:
        """Whether more is to be collected before the next updates."""
        return should_collect_more_steps(frequency, self.steps, self.episodes)

    def earn(
        self, frequency: TrainFreq, *, copies: int, gradient_steps: int, updates_per_episode: float
    ) -> None:
        """Add the updates that a whole rollout asks for, and begin the next one."""
        if frequency.unit is TrainFrequencyUnit.EPISODE:
            self.updates_due += updates_per_episode * self.episodes
        elif gradient_steps == AS_MANY_AS_STEPS:
            self.updates_due += self.steps * copies
        else:
            self.updates_due += gradient_steps
        self.restart()

    def spend(self) -> int:
        """The whole updates that are due, which are now made."""
        updates, self.updates_due = int(self.updates_due), self.updates_due % 1.0
        return updates

    def target_due(self, frequency: TrainFreq, steps: int, episodes: int) -> bool:
        """Whether the target network is to be updated, now that these have passed in the world."""
        self.since_target += steps if frequency.unit is TrainFrequencyUnit.STEP else episodes
        due = self.since_target >= frequency.frequency
        if due:
            self.since_target %= frequency.frequency
        return due
