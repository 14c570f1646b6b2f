# SPDX-License-Identifier: Apache-2.0
"""The camera: exposures, the interface to a sensor, the frame formatter and its messages."""
