"""The demo report: the paper's Figs 2–9 redrawn from the simulated instrument."""

from hueflight.report.report import make_report

__all__ = ["make_report"]
