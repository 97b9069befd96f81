"""What a table of ``benchmarks/whatif_truth.py`` says: its summary, what must hold, its page.

A row is one quantity of one change, as described there; nothing is simulated here.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from animarl_algos.whatif.extrapolation import Caution
from animarl_algos.whatif.shifts import distances

RECORDED = "recorded-agents"
LEVEL = 0.9  # of rows that are to be covered
SMALLER = "arena=x0.8"  # the change that is predicted worst, in a row of its own


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per set and warning: cover, sign, error, and what the warning caught."""
    found = []
    for (name, warning), part in table.groupby(["set", "warning"], sort=False):
        clear = part[part["clear"]]
        error = (clear["miss"] / clear["true"]).abs().median()
        found.append(
            {
                "set": name, "warning": warning,
                "changes": part.groupby(["change", "reading"]).ngroups,
                "rows": len(part), "covered": part["covered"].mean(), "clear": len(clear),
                "sign_right": clear["sign_right"].astype(float).mean(), "median_error": error,
                "wrong": int(part["wrong"].sum()),
            }
        )  # fmt: skip
    return pd.DataFrame(found)


def bars(table: pd.DataFrame) -> pd.DataFrame:
    """Return what must hold: ``set, bar, found, met``; by set and over all sets.

    Inside the training range is what no warning is said of. The sign is asked where both shifts are
    clear of zero, and the error of rows whose true shift is clear of zero. Every row that is wrong
    should have a warning, and few of the others.
    """
    found: list[dict[str, Any]] = []

    def add(name: str, bar: str, value: str, met: bool) -> None:
        found.append({"set": name, "bar": bar, "found": value, "met": "yes" if met else "NO"})

    flags = table[table["change"].str.startswith("condition=") & (table["set"] == RECORDED)]
    for row in flags[flags["quantity"] == "path length"].itertuples():
        error = abs(row.miss / row.true)
        add(RECORDED, f"{row.change}: path within 25 % of the truth, miss covers zero",
            f"{row.predicted:.1f} of {row.true:.1f} ({error:.0%} off), miss "
            f"{row.miss:.1f} [{row.miss_low:.1f}, {row.miss_high:.1f}]",
            error <= 0.25 and row.covered)  # fmt: skip
        add(RECORDED, f"before {row.change}: simulated minus recorded path covers zero",
            f"{row.gap:.1f} [{row.gap_low:.1f}, {row.gap_high:.1f}]",
            row.gap_low <= 0 <= row.gap_high)  # fmt: skip
    for name, part in [*table.groupby("set", sort=False), ("all", table)]:
        inside = part[part["warning"] == Caution.NONE]
        clear = inside[inside["clear"].astype(bool)]
        signs = clear[(clear["low"] > 0) | (clear["high"] < 0)]
        right = int((signs["sign_right"].astype(float) == 1).sum())
        covered = inside["covered"].astype(float).mean()
        error = (clear["miss"] / clear["true"]).abs().median()
        add(name, "no warning: sign right in all", f"{right} of {len(signs)}", right == len(signs))
        add(name, "no warning: interval covers the truth in 90 %", f"{covered:.0%}", covered >= 0.9)
        add(name, "no warning: median error a fifth at most", f"{error:.0%}", error <= 0.2)
        wrong = part["wrong"].astype(bool)
        warned_of = part["warning"] != Caution.NONE
        caught, alarms = int((wrong & warned_of).sum()), int((~wrong & warned_of).sum())
        add(name, "90 % of wrong rows are warned of", f"{caught} of {wrong.sum()}",
            caught >= 0.9 * wrong.sum())  # fmt: skip
        add(name, "20 % of right rows are warned of at most", f"{alarms} of {(~wrong).sum()}",
            alarms <= 0.2 * (~wrong).sum())  # fmt: skip
    return pd.DataFrame(found)


def criteria(table: pd.DataFrame) -> pd.DataFrame:
    """Return what other thresholds of the warning would catch: shares of wrong and right rows.

    ``beyond`` is the share of steps, more than usual, with inputs that training did not have;
    ``readings`` asks too whether habit and knowledge of the new body disagree on a sign.
    """
    turned = (table["other_reading"] * table["predicted"] < 0) & (
        (table["low"] > 0) | (table["high"] < 0)
    )
    turned = turned.groupby([table[key] for key in ("set", "change", "reading")]).transform("any")
    wrong, found = table["wrong"].astype(bool), []
    for readings in (False, True):
        for beyond in (0.05, 0.1, 0.25, 0.5):
            said = (table["beyond"] > beyond) | (turned & readings)
            found.append(
                {"beyond": beyond, "readings": "yes" if readings else "no",
                 "wrong rows": said[wrong].mean(), "right rows": said[~wrong].mean()}
            )  # fmt: skip
    return pd.DataFrame(found)


def held_out_rules(table: pd.DataFrame) -> pd.DataFrame:
    """Return what rules of a warning catch in a set that they were not made on.

    Each rule gives every row a score. Its threshold is the highest that catches 90 % of the wrong
    rows of all other sets. ``all of them`` is a logistic regression of the others' rows.
    """
    width = (table["high"] - table["low"]) / 2 + table["predicted"].abs() + 1e-12
    disagree = ((table["other_reading"] - table["predicted"]).abs() / width).fillna(0).clip(0, 10)
    scores = pd.DataFrame(
        {
            "inputs beyond training": table["beyond"],
            "readings disagree": disagree.groupby(
                [table[key] for key in ("set", "change", "reading")]
            ).transform("max"),
            "gap to the recordings": table["gap"].abs() / width,
            "shift within its interval": -table["predicted"].abs() / width,
            "seeds disagree": (table["seeds_high"] - table["seeds_low"]) / width,
        }
    )
    every = make_pipeline(StandardScaler(), LogisticRegression(class_weight="balanced"))
    wrong, sets, found = table["wrong"].to_numpy(dtype=bool), table["set"].to_numpy(), []
    for rule in [*scores, "all of them"]:
        said = np.zeros(len(table), dtype=bool)
        for name in np.unique(sets):
            own = sets == name
            if rule in scores:
                score = scores[rule].to_numpy()
            else:
                score = every.fit(scores[~own], wrong[~own]).decision_function(scores)
            said[own] = score[own] >= np.quantile(score[~own & wrong], 0.1, method="lower")
        found.append(
            {"rule": rule, "wrong rows": said[wrong].mean(), "right rows": said[~wrong].mean()}
        )
    return pd.DataFrame(found)


def calibration(table: pd.DataFrame) -> pd.DataFrame:
    """Return how often intervals hold the truth, by set and of :data:`SMALLER` arenas.

    A calibrated margin is the hypotenuse of the margin of the miss and of the distances to other
    answers (habit against knowledge, the second simulator); no number in it was fitted. *Wider* is
    the median factor between both margins, and *needed* the factor on the calibrated one with which
    90 % of the rows would be covered. Conditions are left out: their answers are corrected by
    recordings (docs/results/treatments).
    """
    of_conditions = table["change"].str.startswith("condition=")
    seen = table[(table["miss_high"] - table["miss_low"] > 1e-12) & ~of_conditions]
    side = np.where(
        seen["miss"] > 0, seen["miss"] - seen["miss_low"], seen["miss_high"] - seen["miss"]
    ).clip(1e-12)
    answers = seen.rename(columns={"predicted": "shift"}).to_dict("records")
    margin = np.hypot(side, [math.hypot(*distances(one)) for one in answers])
    rows = pd.DataFrame(
        {
            "set": seen["set"], "change": seen["change"],
            "raw": seen["covered"].astype(bool), "wider": margin / side,
            "score": seen["miss"].abs() / margin,
        }
    )  # fmt: skip
    return pd.DataFrame(
        {
            "set": name, "rows": len(own), "raw": own["raw"].mean(),
            "calibrated": (own["score"] <= 1.0).mean(), "wider": own["wider"].median(),
            "needed": own["score"].quantile(LEVEL),
        }
        for name, own in [
            *rows.groupby("set", sort=False), (SMALLER, rows[rows["change"] == SMALLER]),
            ("all", rows),
        ]
    )  # fmt: skip


def warned(table: pd.DataFrame) -> str:
    """Return in words how often wrong and right answers were warned of, by change."""
    changes = table.groupby(["set", "change", "reading"]).agg(
        wrong=("wrong", "mean"), warning=("warning", "first")
    )
    wrong = changes[changes["wrong"] >= 0.5]
    right = changes[changes["wrong"] < 0.5]
    by_set = ", ".join(f"{name} {len(part)}" for name, part in wrong.groupby("set", sort=False))
    red = [int((part["warning"] == Caution.RED).sum()) for part in (wrong, right)]
    some = [int((part["warning"] != Caution.NONE).sum()) for part in (wrong, right)]
    return (
        f"{len(wrong)} of {len(changes)} changes are predicted wrongly in at least half of their "
        f"quantities ({by_set}); {red[0]} of these have a red warning and {some[0]} any; "
        f"of {len(right)} others {red[1]} have a red one and {some[1]} any."
    )


def page(table: pd.DataFrame, short: pd.DataFrame, held: pd.DataFrame) -> str:
    """Return the summary and what must hold in Markdown."""
    made = table.groupby("set", sort=False)[["seeds", "commit"]].first()
    lines = [
        "# What-if answers beside their truth", "",
        "    python benchmarks/whatif_truth.py --out docs/results/whatif", "",
        "; ".join(
            f"{name}: {row.seeds} training seed{'s' * (row.seeds > 1)}, commit {row.commit}"
            for name, row in made.iterrows()
        ) + ".", "",
        "Every row of `whatif_truth.csv` is one quantity of one change; what the columns mean",
        "stands in the benchmark's docstring. `covered`: the interval of predicted minus true",
        "holds zero. `sign right` and `median error` (of the true shift) are over rows whose true",
        "shift is clear of zero.", "",
        "| set | warning | changes | rows | covered | clear | sign right | median error | wrong |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    lines += [
        f"| {row.set} | {row.warning} | {row.changes} | {row.rows} | {row.covered:.0%} | "
        f"{row.clear} | {row.sign_right:.0%} | {row.median_error:.0%} | {row.wrong} |"
        for row in short.itertuples()
    ]
    lines += ["", warned(table), "", "## What must hold", ""]
    lines += map(str.strip, str(bars.__doc__).strip().splitlines()[2:])
    lines += ["", "| set | bar | found | met |", "|---|---|---|---|"]
    lines += [f"| {row.set} | {row.bar} | {row.found} | {row.met} |" for row in held.itertuples()]
    lines += ["", "Shares of rows that a warning would be said of, by its threshold:", ""]
    lines += ["| inputs beyond training above | or readings disagree | of wrong rows | of others |"]
    lines += ["|---|---|---|---|"]
    lines += [
        f"| {row.beyond:.0%} | {row.readings} | {row[3]:.0%} | {row[4]:.0%} |"
        for row in criteria(table).itertuples()
    ]
    if table["set"].nunique() > 1:
        lines += ["", "Rules of a warning, each judged on the set that it was not made on:", ""]
        lines += [*map(str.strip, str(held_out_rules.__doc__).strip().splitlines()[2:]), ""]
        lines += ["| rule | of wrong rows of the set left out | of others |", "|---|---|---|"]
        lines += [f"| {row.rule} | {row[2]:.0%} | {row[3]:.0%} |"
                  for row in held_out_rules(table).itertuples()]  # fmt: skip
    lines += ["", "Calibrated intervals:", ""]
    lines += [*map(str.strip, str(calibration.__doc__).strip().splitlines()[2:]), ""]
    lines += ["| set | rows | covered, raw | covered, calibrated | wider | needed |"]
    lines += ["|---|---|---|---|---|---|"]
    lines += [
        f"| {row.set} | {row.rows} | {row.raw:.1%} | {row.calibrated:.1%} | {row.wider:.2f} | "
        f"{row.needed:.2f} |"
        for row in calibration(table).itertuples()
    ]
    return "\n".join([*lines, ""])
