# SPDX-License-Identifier: Apache-2.0
"""Images from a few sums per pixel, as a camera's reduction core makes them."""
