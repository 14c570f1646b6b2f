# SPDX-License-Identifier: Apache-2.0
"""Reconstructed images as exact messages, and back: every variable as it was."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from hueflight.live.message import Message, MessageError, Plane, encode_message

_BAND_NAMES = "band_name"


def message_of_image(image: xr.Dataset, header: Mapping[str, Any], /) -> bytes:
    """Return the message of an image in the coding ``"exact"``.

    Parameters
    ----------
    image : xarray.Dataset
        Image as `hueflight.reconstruct` gives it, or any dataset of numbers. Of its coordinates
        that are text only the names of bands are sent.
    header : mapping
        What else to state about the picture, such as its number.

    Returns
    -------
    bytes
        The message.
    """
    planes = [
        Plane(
            str(name),
            variable.values,
            tuple(map(str, variable.dims)),
            variable.attrs,
            coordinate=name in image.coords,
        )
        for name, variable in image.variables.items()
        if variable.dtype.kind in "fiub"
    ]
    stated: dict[str, Any] = {**header, "coding": "exact", "attrs": image.attrs}
    if _BAND_NAMES in image.coords:
        stated["band_names"] = image[_BAND_NAMES].values.tolist()
    return encode_message(stated, planes)


def picture_of_message(message: Message, /) -> xr.Dataset:
    """Return the image in a message of the coding ``"exact"``.

    Parameters
    ----------
    message : Message
        Message that was read.

    Returns
    -------
    xarray.Dataset
        The variables as they were sent. The attributes are those of the image and the entries of
        the header. The arrays are views into the message and can't be written to.

    Raises
    ------
    MessageError
        If the message has another coding, or its planes do not fit together.
    """
    header = dict(message.header)
    coding = header.pop("coding", None)
    if coding != "exact":
        raise MessageError(f"the coding of the message is {coding!r}: ask the daemon for 'exact'")
    attrs = {**header.pop("attrs", {}), **header}
    names = attrs.pop("band_names", None)
    variables: dict[str, Any] = {}
    coordinates: dict[str, Any] = {}
    for name, plane in message.planes.items():
        kind = coordinates if plane.coordinate else variables
        kind[name] = (plane.dims, _native(plane.values), dict(plane.attrs))
    if names is not None:
        coordinates[_BAND_NAMES] = ("band", np.array(names, dtype=str))
        coordinates["band"] = ("band", np.array(names, dtype=str))  # labels, for `sel`
    try:
        return xr.Dataset(variables, coordinates, attrs)
    except ValueError as error:
        raise MessageError(f"the planes of the message do not fit together: {error}") from None


def _native(values: np.ndarray) -> np.ndarray:
    """Values in the byte order of this machine."""
    return values.astype(values.dtype.newbyteorder("="), copy=False)
