"""The page of a counterfactual: shifts with their truth, errors, every episode, paths."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from animarl_algos.evaluation import effects as effects_of
from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report.blocks import (
    Block,
    Command,
    Gallery,
    Group,
    Pairs,
    Row,
    Section,
    Sentences,
    Table,
    Text,
)  # fmt: skip
from animarl_algos.report.counterfactual_inputs import CounterfactualInputs
from animarl_algos.report.counterfactual_panels import (
    SHOWN,
    episode_panel,
    path_panels,
    shift_panels,
)
from animarl_algos.report.counterfactual_player import shift_player
from animarl_algos.report.glossary import glossary
from animarl_algos.report.page import Page, render_page
from animarl_algos.report.provenance import (
    code_and_machine,
    flattened,
    licence,
    made_with,
    origin,
    words_to_paste,
)
from animarl_algos.report.sentences import NOTHING, with_interval
from animarl_algos.report.style import method_label


def counterfactual_page(inputs: CounterfactualInputs) -> tuple[list[Section], str]:
    """The sections, whose figures may be written on their own, and the page made of them."""
    sections = [
        Section("shifts", "Shifts and their truth", list(_shifts(inputs))),
        Section("errors", "Error to the demonstrations", list(_errors(inputs))),
        Section("episodes", "Every episode", list(_episodes(inputs))),
        Section("paths", "Factual beside flipped", list(_paths(inputs))),
        Section("provenance", "How this was made", list(_provenance(inputs))),
        Section("paste", "To paste", list(words_to_paste(_methods(inputs), inputs.versions))),
    ]
    sections = [section for section in sections if section.blocks]
    said = [Sentences(list(findings(inputs))), Sentences(list(cautions(inputs)))]
    found = Section("findings", "In short", [block for block in said if block.sentences])
    page = Page(
        title=f"Counterfactual: {', '.join(map(method_label, inputs.asked))}",
        kind="What if the condition had been the other one?",
        synthetic=inputs.demos.synthetic,
        facts=[
            ("Species", inputs.demos.species),
            ("Evaluated on", f"{inputs.demos.num_episodes} demonstrations"),
            *((method_label(name), f"seeds {', '.join(map(str, seeds))}")
              for name, seeds in inputs.seeds.items()),
        ],
        player=shift_player(inputs),
        sections=[found, *sections],
        glossary=glossary(
            map(method_label, inputs.asked), "\n".join(t for s in sections for t in s.texts)
        ),
    )  # fmt: skip
    return sections, render_page(page)


def findings(inputs: CounterfactualInputs) -> Iterator[str]:
    """One sentence for every planned flip: a claim where there is one, or why there is none."""
    for _, row in inputs.effects.claims.iterrows():
        of, told = int(row["condition"]), int(row["told"])
        if (of, told) != inputs.species.planned_flip:
            continue
        name = method_label(str(row["method"]))
        shift = inputs.value(str(row["method"]), effects_of.PREDICTED, of)
        if not row["worded"]:
            yield (
                f"{name}, {inputs.flip(of, told)}: no effect of the cue is claimed, because "
                f"{row['reason']} (predicted shift {with_interval(shift)} {inputs.unit})."
            )
            continue
        words = "longer" if shift.estimate > 0 else "shorter"
        yield (
            f"{name}, {inputs.flip(of, told)}: told the other condition, paths get {words} by "
            f"{with_interval(_size(shift))} {inputs.unit}{_truth(inputs, str(row['method']), of)}."
        )


def cautions(inputs: CounterfactualInputs) -> Iterator[str]:
    """What limits the page's conclusions."""
    if min(len(seeds) for seeds in inputs.seeds.values()) == 1:
        yield (
            "One training seed: intervals speak of starts, for this network only, and nothing is "
            "claimed of its method."
        )
    if inputs.teams is None and not inputs.species.condition_is_sensed:
        yield (
            "No truth is known for these demonstrations: the true shift is missing in all tables."
        )
    if inputs.species.condition_is_sensed:
        yield (
            "The true shift is the same policy in the world of the other condition. Blocked senses "
            "reveal the condition by themselves, so being blind to it costs sensory information."
        )


def _truth(inputs: CounterfactualInputs, method: str, of: int) -> str:
    true = inputs.value(method, effects_of.TRUE, of)
    if not np.isfinite(true.estimate):
        return ""
    missed = inputs.value(method, effects_of.MISSED, of)
    return (
        f"; the true shift is {with_interval(true)}, predicted minus true {with_interval(missed)}"
    )


def _shifts(inputs: CounterfactualInputs) -> Iterator[Block]:
    truth = (
        "its own search in the world of the other condition"
        if inputs.species.condition_is_sensed
        else "what teams trained under the other condition do from the same starts"
    )
    yield Text(
        "A policy is told the other condition; the world, the starts and all random numbers stay "
        f"as they are. The truth is {truth}. Beside it stand two shifts in which nothing of the "
        "condition was learned: of untrained networks, and of the trained ones with the flag "
        "zeroed, asked twice with random numbers of their own."
    )
    yield Gallery(
        list(shift_panels(inputs)),
        f"Shift of the mean path length ({inputs.unit}) with 95 % interval, all episodes; grey: "
        "where nothing of the condition was learned.",
    )
    groups = []
    for counting in effects_of.COUNTINGS:
        lines = []
        for name in inputs.asked:
            for of in (0, 1):
                if inputs.row(name, effects_of.PREDICTED, of, counting) is None:
                    continue
                cells = [
                    method_label(name), _variant(inputs, name), inputs.flip(of, 1 - of),
                    *(with_interval(inputs.value(name, q, of, counting)) for q in SHOWN),
                ]  # fmt: skip
                planned = (of, 1 - of) == inputs.species.planned_flip
                lines.append(Row(cells, strong=planned))
        groups.append(Group(_counted(counting), lines))
    yield Table(
        "Shifts",
        ["Method", "Variant", "Flip", "Predicted", "True", "Predicted\n\u2212 true", "Untrained",
         "Flag\nzeroed"],
        groups,
        f"Mean path length ({inputs.unit}) with the flipped cue minus that with the true one, "
        "[95 % interval]; bold: the flip that was planned in advance. Among captures only starts "
        "in which both answers reached the target count, so that they are paired.",
        left=3,
    )  # fmt: skip


def _errors(inputs: CounterfactualInputs) -> Iterator[Block]:
    table = inputs.effects.table
    rows = table[table["quantity"].isin([effects_of.ERROR, effects_of.ERROR_DIFFERENCE])]
    groups = []
    for counting in effects_of.COUNTINGS:
        lines = [
            Row([
                str(row["method"]).replace(" - ", " \u2212 "), str(row["variant"]),
                inputs.conditions[int(row["condition"])], with_interval(interval(row, "value")),
                _accuracy(inputs, str(row["method"])),
            ])
            for _, row in rows[rows["counting"] == counting].iterrows()
        ]  # fmt: skip
        groups.append(Group(_counted(counting), lines))
    yield Table(
        "Signed errors",
        ["Method", "Variant", "Condition", f"Simulated \u2212 {inputs.recorded}\n({inputs.unit})",
         "Treatment\naccuracy"],
        groups,
        "Mean path length of the rollouts minus that of the demonstrations they started from, in "
        "the same condition [95 % interval], and the difference of the methods' errors. Treatment "
        "accuracy: balanced, on held-out demonstrations; 0.5 is what a memory blind to the "
        "condition gives.",
        left=3,
    )  # fmt: skip


def _episodes(inputs: CounterfactualInputs) -> Iterator[Block]:
    yield Gallery(
        [episode_panel(inputs)],
        "Every episode is a dot (mean over those who move towards the target), bars are means: "
        f"{inputs.recorded}, simulated in either condition, and hollow: told the other condition "
        f"(1: {inputs.conditions[0]}, 2: {inputs.conditions[1]}).",
    )


def _paths(inputs: CounterfactualInputs) -> Iterator[Block]:
    truth, other = (inputs.conditions[c] for c in inputs.planned)
    yield Gallery(
        list(path_panels(inputs)),
        f"From one start each: {inputs.recorded}, simulated told the truth ({truth}), and told the "
        f"other condition ({other}), first seed, first rollout. Starts chosen by rank: the 10th, "
        "50th and 90th percentile of how much the path of "
        f"{method_label(next(iter(inputs.asked)))} changes. Open circles mark starts, filled ones "
        "ends.",
    )


def _provenance(inputs: CounterfactualInputs) -> Iterator[Block]:
    yield Text("To repeat this page:")
    yield Command(inputs.command)
    yield Pairs("World", [*inputs.world.items(), *flattened(inputs.environment)])
    yield Pairs("Demonstrations", [
        ("fingerprint of the evaluated set", inputs.demos.fingerprint()), *origin(inputs.demos),
    ])  # fmt: skip
    yield code_and_machine(inputs.machine, inputs.wall_time)
    yield Pairs("Settings", flattened(inputs.settings))
    yield Pairs("Versions", list(inputs.versions.items()))


def _methods(inputs: CounterfactualInputs) -> str:
    trained = "; ".join(
        f"{method_label(name)}, {len(seeds)} training seed{'s' if len(seeds) != 1 else ''}"
        for name, seeds in inputs.seeds.items()
    )
    truth = (
        ""
        if inputs.teams is None
        else ", beside what the teams of the other condition do from the same starts"
    )
    return (
        f"{made_with(inputs.demos, inputs.versions, inputs.machine)}; licence of the data: "
        f"{licence(inputs.demos)}). Trained policies ({trained}) were rolled out from "
        f"{inputs.demos.num_episodes} test starts, told the condition of the start and, with the "
        "same random numbers, the other one. Shifts are the differences of means over starts, with "
        "95 % intervals over starts and, from two training seeds on, over seeds by Student's t"
        f"{truth}, and beside the shifts of untrained networks and of networks that cannot see the "
        "condition."
    )


def _variant(inputs: CounterfactualInputs, method: str) -> str:
    return "main" if inputs.asked[method].main else "supplementary"


def _accuracy(inputs: CounterfactualInputs, method: str) -> str:
    return with_interval(inputs.value(method, effects_of.ACCURACY, -1)) or NOTHING


def _counted(counting: str) -> str:
    return {"all": "All episodes", "captures": "Captures only, starts that both reach"}[counting]


def _size(value: Interval) -> Interval:
    return value if value.estimate > 0 else Interval(-value.estimate, -value.high, -value.low)
