# SPDX-License-Identifier: Apache-2.0
"""A scene independent of the instrument: its layers, their surfaces and named regions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hueflight.model.spectra import WAVELENGTH_NM, reflectance
from hueflight.simulator.scene import Layer


@dataclass
class SurfaceTable:
    """Surfaces of a scene, numbered in the order of their first use.

    Attributes
    ----------
    spectra : dict of str to ndarray of float, shape (wavelength,)
        Reflectance of each surface at `spectra.WAVELENGTH_NM`, by name.
    """

    spectra: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def __getitem__(self, surface: str) -> int:
        """Number of a surface named in `hueflight.model.spectra`, which is added on first use."""
        if surface not in self.spectra:
            self.spectra[surface] = reflectance(surface)
        return list(self.spectra).index(surface)

    def add(self, name: str, spectrum: NDArray[np.float64]) -> int:
        """Add a surface with a spectrum of its own and return its number."""
        self.spectra[name] = spectrum
        return list(self.spectra).index(name)

    def table(self) -> NDArray[np.float64]:
        """Reflectance of all surfaces in order of their numbers, shape (surface, wavelength)."""
        rows = list(self.spectra.values())
        return np.array(rows).reshape(len(rows), WAVELENGTH_NM.size)


@dataclass(frozen=True)
class Layout:
    """Contents of a scene, independent of the instrument.

    Attributes
    ----------
    layers : tuple of Layer
        Layers of the scene, in any order.
    surfaces : SurfaceTable
        Surfaces to which the layers refer.
    regions : dict of str to tuple of str
        Names of the surfaces that make up each named region.
    gloss : dict of str to float
        Specular reflectance of glossy surfaces at its maximum; others have none.
    """

    layers: tuple[Layer, ...]
    surfaces: SurfaceTable
    regions: dict[str, tuple[str, ...]]
    gloss: dict[str, float] = field(default_factory=dict)
