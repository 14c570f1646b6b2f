# SPDX-License-Identifier: Apache-2.0
"""The frame formatter: turns codes into frame packets without a frame buffer.

A *beat* is the `lanes` codes that the sensor port delivers in one clock; a *group* is eight codes,
which fill `code_bits` bytes; a *chunk* is one run of pixels as it is sent. See
``docs/camera.md`` for how the blocks fit together.
"""
