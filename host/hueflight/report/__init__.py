# SPDX-License-Identifier: Apache-2.0
"""Demo report: the paper's figures and key numbers, reproduced with the simulated instrument."""

from hueflight.report.report import FurtherPage, make_report

__all__ = ["FurtherPage", "make_report"]
