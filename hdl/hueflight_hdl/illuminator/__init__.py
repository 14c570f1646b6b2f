# SPDX-License-Identifier: Apache-2.0
"""The illuminator: the pulse generator, its gearing to the pins, arming and registers."""
