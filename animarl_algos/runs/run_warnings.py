"""What limits the conclusions of a run: the warnings that stand on its page."""

from __future__ import annotations

import json

from animarl_algos.evaluation.acting_choice import NEAR
from animarl_algos.losses.terms import OfflineLoss, Selection
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs.run import Run
from animarl_envs.fitting.result import doubts

INFORMATION = "offline/val/cross_entropy_minus_marginal"


def run_warnings(run: Run) -> list[str]:
    """Return what is doubtful of the fit, of the clones and of how the policy acts.

    The terminal says the same while a run is made.
    """
    return [
        *doubts(run.fit, run.learnable_demos),
        *uninformative_clones(run),
        *far_acting_rules(run),
    ]


def uninformative_clones(run: Run) -> list[str]:
    """Return which clones are no better than predicting action frequencies, as one sentence."""
    algo = run.settings.algo
    cloning = run.record["learner"].get("offline_loss") == OfflineLoss.CLONING
    if not cloning and named_recipe(algo).algorithm.recipe.selection is Selection.MEAN_RANK:
        return []  # its values are no logits
    curves = run.learning_curves()
    own = curves[(curves["method"] == algo) & (curves["phase"] == "offline")]
    own = own[own["quantity"].str.startswith(INFORMATION)]
    best = own.groupby("quantity")["value"].min()
    several = {name for name in best.index if name != INFORMATION}
    names = [
        str(name).removeprefix(INFORMATION).removeprefix("/") or "all individuals"
        for name, value in best.items()
        if value >= 0 and (not several or name in several)
    ]
    if not names:
        return []
    return [
        f"The clone of {', '.join(names)} is no better than predicting action frequencies: give "
        "more demonstrations, more updates, or standardised inputs."
    ]


def far_acting_rules(run: Run) -> list[str]:
    """Return whether no candidate of the acting rules came near the recordings, as one sentence."""
    file = run.acting_file(run.settings.algo)
    if not file.exists():
        return []
    least = min(one["mismatch"] for one in json.loads(file.read_text())["candidates"])
    if least <= NEAR:
        return []
    return [
        f"No candidate of the acting rules came near the recordings (mismatch {least:.2f} on "
        f"training and validation episodes, {NEAR:g} is near): treat the simulator with care."
    ]
