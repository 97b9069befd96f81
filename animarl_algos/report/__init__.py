"""The pages of runs: figures, tables, sentences."""

from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.run_page import write_report
from animarl_algos.report.verdict_section import evaluation_table

__all__ = ["ReportInputs", "evaluation_table", "write_report"]
