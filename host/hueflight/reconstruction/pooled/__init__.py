# SPDX-License-Identifier: Apache-2.0
"""Images from few photons per pixel, estimated over adaptive neighborhoods."""
