# SPDX-License-Identifier: Apache-2.0
"""The registry of methods: a name for each way to estimate an image from a histogram.

A new method is one module (or object) with the two members of `Estimator`, and one line in
`METHODS`. A package outside Hueflight calls `register`, or declares an entry point in the group
``hueflight.methods`` that names such a module or object.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Protocol

from hueflight.calibration import Calibration
from hueflight.errors import HistogramError, HueflightError
from hueflight.reconstruction import joint, paper
from hueflight.reconstruction.estimates import Estimates
from hueflight.reconstruction.inputs import PreparedHistogram
from hueflight.reconstruction.options import BINDING_OPTIONS, EstimatorOptions
from hueflight.reconstruction.pooled import estimate as pooled
from hueflight.reconstruction.sums import method as sums

GROUP = "hueflight.methods"  #: entry points of other packages


class Estimator(Protocol):
    """A way to estimate an image from a histogram.

    Attributes
    ----------
    honors : frozenset of str
        Those of `BINDING_OPTIONS` that the method takes into account. `reconstruct` refuses the
        others.
    """

    @property
    def honors(self) -> frozenset[str]:
        """Options that change the result and that the method takes into account."""
        ...

    def estimate(
        self, prepared: PreparedHistogram, calibration: Calibration, options: EstimatorOptions, /
    ) -> Estimates:
        """Estimate depth and reflectance of every pixel.

        Parameters
        ----------
        prepared : PreparedHistogram
            The histogram, checked and in time order.
        calibration : Calibration
            Calibration of the same instrument.
        options : EstimatorOptions
            What was asked for.

        Returns
        -------
        Estimates
            Results of all pixels.
        """
        ...


METHODS: dict[str, Estimator] = {
    "joint": joint,
    "paper": paper,
    "pooled": pooled,
    "sums": sums,
}


def register(name: str, method: Estimator, /) -> None:
    """Add a method, for use as ``reconstruct(..., method=name)``.

    Parameters
    ----------
    name : str
        A new name.
    method : Estimator
        The method.

    Raises
    ------
    HueflightError
        If there is a method of this name already.
    """
    if name in METHODS:
        raise HueflightError(f"there is a method {name!r} already: choose another name")
    METHODS[name] = method


def find_method(name: str, /) -> Estimator:
    """Return a method by name.

    Parameters
    ----------
    name : str
        A key of `METHODS`, or the name of an entry point in the group ``hueflight.methods``.

    Returns
    -------
    Estimator
        The method.

    Raises
    ------
    HistogramError
        If there is no such method.
    """
    if name not in METHODS:
        for entry in entry_points(group=GROUP, name=name):
            register(name, entry.load())
    if name not in METHODS:
        raise HistogramError(f"method = {name!r}: choose one of {', '.join(METHODS)}")
    return METHODS[name]


def check_options(name: str, method: Estimator, options: EstimatorOptions, /) -> None:
    """Refuse options that a method would ignore although they change the result.

    Parameters
    ----------
    name : str
        Name of the method.
    method : Estimator
        The method.
    options : EstimatorOptions
        What was asked for.

    Raises
    ------
    HueflightError
        If an option that the method does not honor differs from its default.
    """
    for option in sorted(BINDING_OPTIONS - method.honors):
        value = getattr(options, option)
        if value != getattr(EstimatorOptions(), option):
            others = [other for other, known in METHODS.items() if option in known.honors]
            raise HueflightError(
                f"{option} = {value!r}: method {name!r} can't take it into account; "
                f"use method={' or '.join(map(repr, others))}"
            )
