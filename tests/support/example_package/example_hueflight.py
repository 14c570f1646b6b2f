# SPDX-License-Identifier: Apache-2.0
"""A package of somebody else that adds a rig, a reader of counts and a format for images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from hueflight.devices import Camera, NoIllumination, RigAddress, RigPart
from hueflight.emulation import CameraModel, FrameBank
from hueflight.emulation.simulated_transport import SimulatedStream, SimulatedTransport
from hueflight.errors import FileFormatError
from hueflight.export import Format
from hueflight.files import staged
from hueflight.importers.options import ReadOptions, require_instrument
from hueflight.model.instrument import Instrument

MAGIC = b"EXAMPLE\0"


def open_part(address: RigAddress, instrument: Instrument, /) -> RigPart:
    """A camera in memory, whose photons are noise: example:?occupancy=0.2."""
    options = address.convert_options(occupancy=float)
    occupancy = options.get("occupancy", 0.3)

    def open_camera() -> Camera:
        bank = FrameBank.random(instrument.sensor, occupancy=occupancy, frames=8, seed=3)
        model = CameraModel(instrument.sensor, bank)
        return Camera(
            SimulatedTransport(model.handle, "example"),
            lambda size: SimulatedStream(model, size),
            simulated=True,
        )

    return RigPart(open_camera=open_camera, open_illumination=NoIllumination)


def read_counts(
    path: Path, instrument: Instrument | None, options: ReadOptions, /
) -> tuple[NDArray[np.uint32], Instrument]:
    """Counts behind a magic number, as unsigned 32-bit integers."""
    options.refuse_all_but(path=path)
    given = require_instrument(instrument, path)
    content = path.read_bytes()
    size = 4 * int(np.prod(given.histogram_shape))
    if content[:8] != MAGIC or len(content) != 8 + size:
        raise FileFormatError(f"{str(path)!r} is no example file, or was cut short")
    counts = np.frombuffer(content, "<u4", offset=8).reshape(given.histogram_shape)
    return counts, given


def write_text(image: xr.Dataset, path: Path, /, *, overwrite: bool = False) -> None:
    """Depth as a table of numbers."""
    with staged(path, overwrite=overwrite) as partial:
        np.savetxt(partial, image["depth"].transpose("row", "col").values)


TEXT = Format("depth-table", (".depthtable",), write_text, False, "depth as a table of numbers")
