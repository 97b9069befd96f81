"""Write the tables of the results and leaderboard pages from the CSV beside them.

python docs/make_results_tables.py
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

DOCS = Path(__file__).parent
TEST_TABLE = DOCS / "results" / "test" / "faithful.csv"
TESTED = {
    "agent": "50 episodes, synthetic",
    "fly": "10 episodes, synthetic",
    "newt": "20 episodes, synthetic",
    "silkmoth": "12 episodes, synthetic",
    "solo": "40 episodes, synthetic",
    "shoal": "13 episodes, synthetic",
    "fly-folds": "107 episodes, synthetic",
    "newt-folds": "280 episodes, synthetic",
    "silkmoth-folds": "60 episodes, synthetic",
    "agents-indiv": "50 episodes, artificial agents",
    "agents-share": "50 episodes, artificial agents",
    "chase-1": "20 chases, artificial agents",
    "chase-3": "20 chases, artificial agents",
    "agent-cut": "50 episodes that are cut, synthetic",
    "moths": "24 recordings, living",
    "termites": "67 episodes of 20 recordings, living",
    "fly-groups": "80 pieces of 8 recordings, living",
    "courtship": "10 pieces of 1 recording, living",
    "termites_alone": "36 recordings of 18 animals, living",
    "larvae": "80 recordings, living",
    "bats_obstacles": "296 recordings, living",
    "fish15": "17 pieces of 1 recording, living",
    "locusts": "22 pieces of 1 recording, living",
}
"""What each set of ``benchmarks/faithful.py`` is tested on, and whether it lives.

Sets that the table lacks are left out.
"""

BOARDS = ("agent", "fly", "newt", "silkmoth", "recorded-agents", "recorded",
          "paper/agent", "paper/silkmoth")  # fmt: skip
METHODS = ("recordings", "tracking", "soft-bc", "bc", "iq-learn", "dqaas", "dqdil-pt", "dqdil",
           "dqn", "scripted", "random")  # fmt: skip
WORDS = ("alike", "differs a little", "differs", "not known")
SAME = ("alike", "not known")
"""How the words of a row begin that does not differ."""


def markdown(head: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def seeds(numbers: list[int]) -> str:
    """Return "seed 1" or "seeds 0, 2"."""
    return f"seed{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def by_seed(texts: dict[int, str], count: int) -> str:
    """Join the texts of seeds, naming the seeds unless all of so many say the same."""
    groups: dict[str, list[int]] = {}
    for seed, text in texts.items():
        groups.setdefault(text, []).append(seed)
    if len(texts) == count and len(groups) == 1:
        return next(iter(groups))
    return "; ".join(f"{text} ({seeds(of)})" for text, of in groups.items())


def verdicts() -> str:
    """Return how many questions of every set have which word, what differs, and missed bars."""
    cells, bars = (
        pd.read_csv(TEST_TABLE.with_name(f"{name}.csv")) for name in ("verdicts", "faithful")
    )
    cells["complaints"] = cells["complaints"].fillna("")
    bars = bars[bars["met?"] == "no"]
    rows = []
    for name, tested in TESTED.items():
        own, missed = cells[cells["set"] == name], bars[bars["set"] == name]
        if own.empty:
            continue
        differ = dict(zip(own["seed"], own["complaints"], strict=True))
        known = own.dropna(subset="auc")
        areas = zip(known["auc"], known["auc_low"], known["auc_high"], strict=True)
        rows.append(
            [
                name,
                tested,
                ", ".join(map(str, own["seed"])),
                *(", ".join(map(str, own[word])) for word in WORDS),
                by_seed({seed: text for seed, text in differ.items() if text}, len(own)) or "–",
                ", ".join(f"{area:.2f} [{low:.2f}, {high:.2f}]" for area, low, high in areas)
                or "–",
                "; ".join(
                    f"{label} ({seeds(list(of['seed']))})"
                    for label, of in missed.groupby("label", sort=False)
                )
                or "–",
            ]
        )
    return markdown(
        ["set", "tested on", "seeds", "alike", "a little", "differ", "not known", "what differs",
         "classifier on 2 s: AUC", "bars not met"], rows,
    )  # fmt: skip


def differing_rows() -> str:
    """Return the rows with a bar that differ, or differ a little, in the verdict's words."""
    table = pd.read_csv(TEST_TABLE).dropna(subset=["verdict"])
    rows = []
    for name in TESTED:
        count = table.loc[table["set"] == name, "seed"].nunique()
        cells = table[(table["set"] == name) & ~table["verdict"].str.startswith(SAME)]
        for label, found in cells.groupby("label", sort=False):
            words = by_seed(dict(zip(found["seed"], found["verdict"], strict=True)), count)
            values = ", ".join(f"{value:.3g}" for value in found["simulated"])
            recorded = ", ".join(dict.fromkeys(f"{value:.3g}" for value in found["recorded"]))
            rows.append([name, str(label), recorded, values, words])
    return markdown(["set", "row", "recorded", "simulated", "verdict"], rows)


def areas() -> str:
    """Return the AUC of every method on every board, beside recordings and tracking."""
    rows = []
    for board in BOARDS:
        table = pd.read_csv(DOCS / "leaderboard" / board / "leaderboard.csv")
        table = table[table["measure"] == "auc"]
        for name, found in table.groupby("data", sort=False):
            by_method = found.set_index("method")

            def shown(method: str, found: pd.DataFrame = by_method) -> str:
                if method not in found.index:
                    return "–"
                row = found.loc[method]
                if method == "recordings":
                    return f"{row['value']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"
                return f"{row['value']:.2f}"

            title = f"paper: {name}" if board.startswith("paper") else str(name)
            starts, null = by_method["starts"].max(), by_method["null"].iloc[0]
            rows.append([title, str(starts), f"{null:.2f}", *map(shown, METHODS)])
    return markdown(["set", "starts", "null", *METHODS], rows)


PAGES = {
    DOCS / "results" / "README.md": {"verdicts": verdicts, "rows that differ": differing_rows},
    DOCS / "leaderboard" / "README.md": {"areas": areas},
}


def marks(name: str) -> tuple[str, str]:
    """Return what stands before and behind the table called ``name``."""
    return f"<!-- {name}: docs/make_results_tables.py -->\n", f"<!-- end of {name} -->"


def main() -> None:
    """Put every table between its two marks."""
    for page, tables in PAGES.items():
        text = page.read_text()
        for name, make in tables.items():
            begin, end = marks(name)
            before, rest = text.split(begin)
            text = f"{before}{begin}\n{make()}\n\n{end}{rest.split(end)[1]}"
        page.write_text(text)


if __name__ == "__main__":
    main()
