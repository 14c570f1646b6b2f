# SPDX-License-Identifier: Apache-2.0
"""Arguments of the compiled fit that depend on its tables alone, which are made once and kept."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from hueflight.fit import assessment
from hueflight.fit.packing import PackedDelays, PackedSearch, PackedTables, pack, rules, sizes
from hueflight.fit.reference import FitOptions
from hueflight.fit.tables import ModelTables

_Arrays = Mapping[str, NDArray[Any]]

_packed: WeakKeyDictionary[ModelTables, PackedTables] = WeakKeyDictionary()
#: of each tables those that the options change, and under None those for the assessment
_kept: WeakKeyDictionary[ModelTables, dict[FitOptions | None, _Arrays]] = WeakKeyDictionary()


def table_arguments(tables: ModelTables, options: FitOptions) -> _Arrays:
    """Return the tables and rules of a fit as its kernel takes them.

    Parameters
    ----------
    tables : ModelTables
        Tables of the fit.
    options : FitOptions
        What the fit may leave out.

    Returns
    -------
    mapping of str to ndarray
        Arrays by the names of the arguments, which are not to be changed.
    """
    kept = _kept.setdefault(tables, {})
    if options not in kept:
        if tables not in _packed:
            _packed[tables] = pack(tables)
        packed = _packed[tables]
        kept[options] = {
            "sizes": sizes(tables, packed),
            "rules": rules(tables, options),
            "view_bins": np.array([view.bins.count for view in tables.views], np.int32),
            **_named("fine", packed.fine),
            **_named("wide", packed.wide),
            **_named("search", packed.search),
        }
    return kept[options]


def assessment_arguments(tables: ModelTables) -> _Arrays:
    """Return what the tests of a fit need besides its tables.

    Parameters
    ----------
    tables : ModelTables
        Tables of the fit.

    Returns
    -------
    mapping of str to ndarray
        Arrays by the names of the arguments, which are not to be changed.
    """
    kept = _kept.setdefault(tables, {})
    if None not in kept:
        _, means, variances = assessment.deviance_table()
        kept[None] = {
            "contrasts": np.ascontiguousarray(tables.contrasts, np.float32),
            "curvatures": assessment.curvature_ratios(tables.wide).astype(np.float32),
            "moments": np.stack([means, variances], axis=1).astype(np.float32),
        }
    return kept[None]


def _named(prefix: str, tables: PackedDelays | PackedSearch) -> _Arrays:
    return {f"{prefix}_{name}": array for name, array in tables.arrays().items()}
