"""A scene before an instrument looks at it: layers, the surfaces they are painted with, regions."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hueflight.model.spectra import WAVELENGTH_NM, reflectance
from hueflight.simulator.scene import Layer


@dataclass
class SurfaceTable:
    """Surfaces in use, numbered in the order of their first use."""

    spectra: dict[str, NDArray[np.float64]] = field(default_factory=dict)

    def __getitem__(self, surface: str) -> int:
        """Number of a named surface."""
        if surface not in self.spectra:
            self.spectra[surface] = reflectance(surface)
        return list(self.spectra).index(surface)

    def add(self, name: str, spectrum: NDArray[np.float64]) -> int:
        """Number of a surface with its own spectrum."""
        self.spectra[name] = spectrum
        return list(self.spectra).index(name)

    def table(self) -> NDArray[np.float64]:
        """(surface, wavelength)."""
        rows = list(self.spectra.values())
        return np.array(rows).reshape(len(rows), WAVELENGTH_NM.size)


@dataclass(frozen=True)
class Layout:
    """Layers in any order, their surfaces, and which surfaces make up each named region.

    `gloss` gives glossy surfaces the height of their mirror-like reflection.
    """

    layers: tuple[Layer, ...]
    surfaces: SurfaceTable
    regions: dict[str, tuple[str, ...]]
    gloss: dict[str, float] = field(default_factory=dict)
