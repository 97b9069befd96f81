"""Write the table of the learners' defaults into docs/learners.md, as ``zoo_configs`` has them.

python docs/make_defaults_table.py
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from animarl_algos.learner.presets import COMMON_SECTION
from animarl_algos.learner.settings import LearnerSettings, OfflineSettings
from animarl_algos.recipes.registry import RECIPES
from animarl_envs import SPECIES, environment_id
from animarl_envs.settings import describe_fields

PAGE = Path(__file__).with_name("learners.md")
BEGIN, END = "<!-- defaults: docs/make_defaults_table.py -->\n", "<!-- end of defaults -->\n"
BEGIN_OFFLINE = "<!-- offline_kwargs: docs/make_defaults_table.py -->\n"
ALGOS = [name for name in RECIPES if not name.startswith("qr-")]
"""The quantile twins have ``policy_kwargs: {n_quantiles: 20}`` beside."""


def defaults(algo: str, species: str | None) -> dict[str, Any]:
    """What the learner called ``algo`` takes where it is not told."""
    env = COMMON_SECTION if species is None else environment_id(species)
    learner = RECIPES[algo].algorithm
    return learner.default_settings(env, pretrained=algo == learner.pretrained_preset)


def shown(value: Any) -> str:
    """A value as Python writes it, a rate in short."""
    value = list(value) if isinstance(value, tuple) else value
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
    meanings = describe_fields(LearnerSettings)
    rows = (
        f"| `{name}` | {shown(every['dqn', None][name])} | {exceptions(name, every)} "
        f"| {in_markdown(meanings[name])} |"
        for name in vars(LearnerSettings())
    )
    head = ["| setting | default | elsewhere | meaning |", "|---|---|---|---|"]
    return "\n".join([*head, *rows]) + "\n"


def offline_table() -> str:
    """The rows for ``offline_kwargs``, in Markdown."""
    defaults = vars(OfflineSettings())
    rows = (
        f"| `{name}` | {shown(defaults[name])} | {in_markdown(meaning)} |"
        for name, meaning in describe_fields(OfflineSettings).items()
    )
    return "\n".join(["| setting | default | meaning |", "|---|---|---|", *rows]) + "\n"


def in_markdown(text: str) -> str:
    """Docstring markup as Markdown."""
    return re.sub(r":class:`[\w.]*?(\w+)`", r"`\1`", text).replace("``", "`")


def main() -> None:
    """Put the tables between their marks."""
    page = PAGE.read_text()
    for begin, made in ((BEGIN, table()), (BEGIN_OFFLINE, offline_table())):
        before, rest = page.split(begin)
        page = f"{before}{begin}\n{made}\n{END}{rest.split(END, 1)[1]}"
    PAGE.write_text(page)


if __name__ == "__main__":
    main()
