# SPDX-License-Identifier: Apache-2.0
"""Which kernels run, compiled or NumPy, and why.

Every hot loop of Hueflight exists twice: as C, and as the NumPy code that defines what it computes.
The environment variable ``HUEFLIGHT_KERNELS`` chooses between them; only this package reads it.
"""

from hueflight.backend.loading import KERNELS, available, compiled, describe, requested, why_not

__all__ = ["KERNELS", "available", "compiled", "describe", "requested", "why_not"]
