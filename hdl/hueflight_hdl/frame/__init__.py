"""The frame formatter: codes in, frame packets out, with no frame buffer.

A *beat* is what the sensor port gives in one clock, `lanes` codes; a *group* is eight codes,
which fill `code_bits` bytes; a *chunk* is one run of pixels as it is sent. See
``docs/camera.md`` for how the blocks fit together.
"""
