"""The report of a run: one HTML file, with everything in it, to show to a colleague."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from animarl_algos.report.blocks import Section
from animarl_algos.report.glossary import glossary
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.page import Page, render_page
from animarl_algos.report.scenes import Player
from animarl_algos.report.sections import build_sections, facts, lead
from animarl_algos.report.style import method_label
from animarl_envs.files import write_then_rename


def render_report(inputs: ReportInputs, sections: Sequence[Section] | None = None) -> str:
    """The report as HTML that loads nothing from anywhere; its sections may have been built."""
    sections = build_sections(inputs) if sections is None else sections
    text = "\n".join(text for section in sections for text in section.texts)
    return render_page(
        Page(
            title=inputs.title,
            kind="Simulation report",
            synthetic=inputs.demos.synthetic,
            facts=facts(inputs),
            lead=lead(inputs),
            player=Player.of(inputs),
            sections=sections,
            glossary=glossary(map(method_label, inputs.rollouts), text),
        )
    )


def write_report(inputs: ReportInputs, out: str | Path) -> Path:
    """Write the report to ``out``, whole or not at all, and return the path."""
    out = Path(out)
    html = render_report(inputs)
    with write_then_rename(out) as part:
        part.write_text(html, encoding="utf-8")
    return out
