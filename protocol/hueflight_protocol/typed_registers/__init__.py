# SPDX-License-Identifier: Apache-2.0
"""Registers as types, one module for each board; generated, so that names are checked."""

from . import camera, common, illuminator

__all__ = ["camera", "common", "illuminator"]
