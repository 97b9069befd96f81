"""What limits a run stands on its page, as the terminal said it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pandas as pd
import pytest
from report_inputs import rendered, report_inputs

from animarl_algos.runs.run_warnings import (
    INFORMATION,
    far_acting_rules,
    uninformative_clones,
)


def run_of(folder: Path, algo: str, curves: dict[str, list[float]]) -> SimpleNamespace:
    rows = [
        {"method": algo, "phase": "offline", "quantity": INFORMATION + name, "value": value}
        for name, values in curves.items()
        for value in values
    ]
    return SimpleNamespace(
        path=folder, settings=SimpleNamespace(algo=algo), record={"learner": {}},
        learning_curves=lambda: pd.DataFrame(rows),
        acting_file=lambda name: folder / "policies" / f"{name}.acting.json",
    )  # fmt: skip


def test_a_clone_that_learned_nothing_is_named(tmp_path: Path) -> None:
    curves = {"": [0.2, 0.0], "/male": [0.1, 0.05], "/female": [0.3, -0.05]}
    (sentence,) = uninformative_clones(run_of(tmp_path, "soft-bc", curves))
    assert "clone of male is no better than predicting action frequencies" in sentence
    assert uninformative_clones(run_of(tmp_path, "bc", {"": [0.3, -0.1]})) == []
    assert uninformative_clones(run_of(tmp_path, "dqdil-pt", curves)) == []  # values, no logits


@pytest.mark.parametrize(("least", "said"), [(0.29, False), (0.31, True)])
def test_acting_rules_that_are_all_far_are_said(tmp_path: Path, least: float, said: bool) -> None:
    run = run_of(tmp_path, "soft-bc", {})
    assert far_acting_rules(run) == []  # --acting was given
    file = tmp_path / "policies" / "soft-bc.acting.json"
    file.parent.mkdir()
    file.write_text(json.dumps({"candidates": [{"mismatch": 1.0}, {"mismatch": least}]}))
    assert len(far_acting_rules(run)) == said


def test_warnings_stand_on_the_page_once() -> None:
    warned = replace(report_inputs(), warnings=("It jumps & jumps.", "It jumps & jumps."))
    page = rendered(warned)
    assert page.count('<p class="caution">It jumps &amp; jumps.</p>') == 1
