# SPDX-License-Identifier: Apache-2.0
"""The joint maximum-likelihood fit: tables, NumPy definition and compiled solver.

The names below are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from hueflight.lazy import lazy_names

if TYPE_CHECKING:  # for type checkers and editors; `_HOME` says the same at run time
    from hueflight.fit.correlation import correlate, peak_centroid
    from hueflight.fit.detection import log_likelihood_ratio
    from hueflight.fit.reference import Fit, FitOptions, fit
    from hueflight.fit.search_tables import SearchTables
    from hueflight.fit.solver import fit_pixels
    from hueflight.fit.tables import (
        DelayTables,
        ModelTables,
        ScheduleView,
        detection_threshold,
        make_tables,
    )

#: module of each public name
_HOME = {
    "DelayTables": "hueflight.fit.tables",
    "Fit": "hueflight.fit.reference",
    "FitOptions": "hueflight.fit.reference",
    "ModelTables": "hueflight.fit.tables",
    "ScheduleView": "hueflight.fit.tables",
    "SearchTables": "hueflight.fit.search_tables",
    "correlate": "hueflight.fit.correlation",
    "detection_threshold": "hueflight.fit.tables",
    "fit": "hueflight.fit.reference",
    "fit_pixels": "hueflight.fit.solver",
    "log_likelihood_ratio": "hueflight.fit.detection",
    "make_tables": "hueflight.fit.tables",
    "peak_centroid": "hueflight.fit.correlation",
}

__all__ = [
    "DelayTables",
    "Fit",
    "FitOptions",
    "ModelTables",
    "ScheduleView",
    "SearchTables",
    "correlate",
    "detection_threshold",
    "fit",
    "fit_pixels",
    "log_likelihood_ratio",
    "make_tables",
    "peak_centroid",
]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
