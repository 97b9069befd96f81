"""The report of a run: one HTML file, with everything in it, to show to a colleague."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from animarl_algos.report.blocks import Section, Summary
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.sections import build_sections, facts, summary
from animarl_envs.errors import MissingExtraError
from animarl_envs.files import write_then_rename


def render_report(inputs: ReportInputs, sections: Sequence[Section] | None = None) -> str:
    """The report as HTML that loads nothing from anywhere; its sections may have been built."""
    return render_page(
        title=inputs.title,
        synthetic=inputs.demos.synthetic,
        facts=facts(inputs),
        summary=summary(inputs),
        sections=build_sections(inputs) if sections is None else sections,
    )


def render_page(
    *,
    title: str,
    synthetic: bool,
    facts: Sequence[tuple[str, str]],
    summary: Summary,
    sections: Sequence[Section],
) -> str:
    """A page of blocks as HTML that loads nothing from anywhere."""
    try:
        from jinja2 import Environment, FileSystemLoader, StrictUndefined
    except ImportError as error:
        raise MissingExtraError("the report", "algos") from error
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html.j2").render(
        title=title, synthetic=synthetic, facts=facts, summary=summary, sections=sections
    )


def write_report(inputs: ReportInputs, out: str | Path) -> Path:
    """Write the report to ``out``, whole or not at all, and return the path."""
    out = Path(out)
    html = render_report(inputs)
    with write_then_rename(out) as part:
        part.write_text(html, encoding="utf-8")
    return out
