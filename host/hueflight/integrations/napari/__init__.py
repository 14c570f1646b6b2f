# SPDX-License-Identifier: Apache-2.0
"""Plugin for napari: a reader of our files, and live pictures as layers.

The manifest ``napari.yaml`` tells napari what there is; see the page *napari* of the documentation.
"""
