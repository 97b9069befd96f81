"""The words of a report that a biologist need not know, explained where the page uses them."""

from __future__ import annotations

import re
from collections.abc import Iterable

RECIPES = {
    "BC": "Behaviour cloning: the network learns to take the demonstrated action.",
    "SOFT-BC": "Behaviour cloning that is told, instead of one action, how near each action comes "
    "to the demonstrated movement.",
    "DQN": "Deep Q-network: learns from the task's reward alone, by trying.",
    "DQAAS": "Deep Q-learning with adaptive action supervision: besides the reward, the network is "
    "taught the demonstrated action.",
    "DQDIL": "Deep Q-learning with a distance-based imitation reward: paid for staying near the "
    "demonstrated path (by dynamic time warping).",
    "DQCIL": "DQDIL that also learns of two experimental conditions, so that it can be asked what "
    "the other condition would do.",
    "PT": "After a recipe's name: pretrained on demonstrations before it begins to act.",
    "QR": "Before a recipe's name: the network learns quantiles of the return, not only its mean.",
    "untrained": "The same network before training.",
    "random": "Every action equally often.",
}
TERMS = {
    "AUC": "Area under the ROC curve: how often a classifier ranks a simulated window above a "
    "demonstrated one. 0.5 is chance: it cannot tell them apart. 1 is always.",
    "Advantage": "What one action is worth beyond the mean of all actions in that state.",
    "DTW": "Dynamic time warping: the distance between two paths after the best alignment in time, "
    "summed along it.",
    "Energy score": "How far simulated values are from the demonstrated one, less how far they are "
    "from each other; the smaller the better. Returning always the same value does not lower it.",
    "Interval": "In brackets, 95 %: how far the estimate might be off by the choice of "
    "demonstrations (and training seeds, where there are several).",
    "KDE": "Kernel-density distance: the area between two smoothed histograms, from 0 (the same) "
    "to 2 (disjoint).",
    "Null": "How large a distance becomes by chance alone, were the simulator perfect.",
    "Q": "Action value: the return that the network expects if it takes an action now.",
    "Rollout": "One simulated episode, begun where a demonstration begins.",
    "Start": "The first moment of a demonstration: places and velocities of everybody.",
    "Wasserstein": "Wasserstein distance: how far values must be moved, on average, to turn one "
    "distribution into the other; in the values' own unit.",
}
WRITTEN = {"KDE": "(KDE|kernel-density)", "Q": "(?-i:Q)"}
"""Regular expressions of terms that a page writes in another way."""


def glossary(methods: Iterable[str], page: str) -> list[tuple[str, str]]:
    """Terms that stand on the page, and the recipes among its methods, in alphabetical order.

    Parameters
    ----------
    methods
        As they are called on the page.
    page
        All its texts.
    """
    parts = {part.casefold() for name in methods for part in (name, *name.split("-"))}
    used = {name: told for name, told in RECIPES.items() if name.casefold() in parts}
    used |= {
        term: told
        for term, told in TERMS.items()
        if re.search(rf"\b{WRITTEN.get(term, term)}s?\b", page, re.IGNORECASE)
    }
    return sorted(used.items(), key=lambda item: item[0].casefold())
