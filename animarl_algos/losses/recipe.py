"""What a recipe is: the terms of its loss in each phase, and what it asks of its environment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from animarl_algos.losses.terms import LossTerm, SoftActionSupervision, TreatmentAdversary


class Selection(StrEnum):
    """Validation figure (the lower the better) by which the best offline epoch is kept."""

    CROSS_ENTROPY = "cross_entropy"  # of the demonstrated action, values as logits [nat]
    LABEL_CROSS_ENTROPY = "label_cross_entropy"  # of the labels learned from, soft ones too [nat]
    MEAN_RANK = "mean_rank"  # of the demonstrated action's value among all actions, best 1


class OfflineLoss(StrEnum):
    """What the offline phase minimises."""

    RECIPE = "recipe"  # the recipe's own terms (the paper)
    CLONING = "cloning"  # cross-entropy of soft labels


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """The loss terms of a learner (paper, "Baseline methods").

    Attributes
    ----------
    name
        As on the command line, without the prefix ``qr-``.
    online, offline
        Terms of the two phases; empty where a recipe has no such phase.
    selection
        How its best offline epoch is chosen.
    needs_distance
        Whether the environment must hand out ``dtw_penalty``.
    needs_alignment
        Whether it must hand out ``aligned_action``.
    needs_condition
        Whether the last observation component must be the condition flag (treatment head).
    inverse
        Whether the online phase learns from demonstrated steps beside its own, action values being
        the logits of the policy: it acts by ``softmax Q`` at temperature 1.
    """

    name: str
    online: tuple[LossTerm, ...]
    offline: tuple[LossTerm, ...] = ()
    selection: Selection = Selection.MEAN_RANK
    needs_distance: bool = False
    needs_alignment: bool = False
    needs_condition: bool = False
    inverse: bool = False

    def cloning(self) -> Recipe:
        """The same with an offline phase that clones, and keeps only the adversary of its own.

        Values regressed towards penalties are soft labels too, of a scale that nobody chose.
        """
        kept = (term for term in self.offline if isinstance(term, TreatmentAdversary))
        return replace(
            self,
            offline=(SoftActionSupervision(), *kept),
            selection=Selection.LABEL_CROSS_ENTROPY,
        )
