"""Write the table of the learners' defaults into docs/learners.md, as ``zoo_configs`` has them.

python docs/make_defaults_table.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from animarl_algos.learner.presets import OF_NO_SPECIES, beneath
from animarl_algos.recipes.registry import RECIPES
from animarl_envs import SPECIES, environment_id

PAGE = Path(__file__).with_name("learners.md")
BEGIN, END = "<!-- defaults: docs/make_defaults_table.py -->\n", "<!-- end of defaults -->\n"
ALGOS = [name for name in RECIPES if not name.startswith("qr-")]
"""The quantile twins have ``policy_kwargs: {n_quantiles: 20}`` beside."""


def defaults(algo: str, species: str | None) -> dict[str, Any]:
    """What the learner called ``algo`` takes where it is not told."""
    env = OF_NO_SPECIES if species is None else environment_id(species)
    learner = RECIPES[algo].algorithm
    return learner.default_settings(env, pretrained=algo == learner.pretrained_preset)


def shown(value: Any) -> str:
    """A value as Python writes it, a rate in short."""
    return f"`{value:g}`" if isinstance(value, float) and value < 1e-3 else f"`{value!r}`"


def listed(algos: list[str]) -> str:
    return ", ".join(f"`{algo}`" for algo in algos)


def exceptions(name: str, every: dict[tuple[str, str | None], dict[str, Any]]) -> str:
    """Where a setting is another than ``dqn``'s in an environment of no species."""
    groups: dict[tuple[str | None, str], list[str]] = {}
    for algo in ALGOS:
        common = every[algo, None][name]
        if common != every["dqn", None][name]:
            groups.setdefault((None, shown(common)), []).append(algo)
        for species in SPECIES:
            if (own := every[algo, species][name]) != common:
                groups.setdefault((species, shown(own)), []).append(algo)
    ordered = sorted(groups.items(), key=lambda item: item[0][0] is not None)
    return "; ".join(
        f"{value} {'' if species is None else f'{species}: '}{listed(algos)}"
        for (species, value), algos in ordered
    )


def table() -> str:
    """The rows, in Markdown."""
    every = {(a, s): defaults(a, s) for a in ALGOS for s in (None, *SPECIES)}
    rows = (
        f"| `{name}` | {shown(every['dqn', None][name])} | {exceptions(name, every)} |"
        for name in beneath()
    )
    return "\n".join(["| setting | default | elsewhere |", "|---|---|---|", *rows]) + "\n"


def main() -> None:
    """Put the table between its two marks."""
    before, rest = PAGE.read_text().split(BEGIN)
    PAGE.write_text(before + BEGIN + "\n" + table() + "\n" + END + rest.split(END)[1])


if __name__ == "__main__":
    main()
