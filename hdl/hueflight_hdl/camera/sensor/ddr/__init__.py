# SPDX-License-Identifier: Apache-2.0
"""A sensor behind pins: serial lanes at double data rate, with a clock of the sensor."""
