# SPDX-License-Identifier: Apache-2.0
"""Writers of images, histograms and photon lists in formats that other software reads."""

from hueflight.export.description import describe
from hueflight.export.envi import write_envi
from hueflight.export.formats import FORMATS, Format, write
from hueflight.export.foxglove import write_foxglove
from hueflight.export.foxglove_recording import add_foxglove_channels
from hueflight.export.histograms import write_histogram
from hueflight.export.las import write_las
from hueflight.export.ome import write_ome_tiff
from hueflight.export.photons import write_photons
from hueflight.export.ply import write_ply
from hueflight.export.points import Points, image_points
from hueflight.export.preview import write_png, write_previews
from hueflight.export.stores import write_netcdf, write_zarr
from hueflight.export.tables import write_csv
from hueflight.export.tiff import write_tiff

__all__ = [
    "FORMATS",
    "Format",
    "Points",
    "add_foxglove_channels",
    "describe",
    "image_points",
    "write",
    "write_csv",
    "write_envi",
    "write_foxglove",
    "write_histogram",
    "write_las",
    "write_netcdf",
    "write_ome_tiff",
    "write_photons",
    "write_ply",
    "write_png",
    "write_previews",
    "write_tiff",
    "write_zarr",
]
