# SPDX-License-Identifier: Apache-2.0
"""The interface to a sensor's readout, and a synthetic sensor that implements it."""
