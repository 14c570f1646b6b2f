# SPDX-License-Identifier: Apache-2.0
"""How the camera shows itself on USB: identifiers, interfaces, endpoints.

Two vendor-specific interfaces, so that control and stream can be claimed by different handles:
0 carries control messages (bulk out and in), 1 the packet stream (bulk in).
"""

from __future__ import annotations

VENDOR_ID = 0x1209  #: pid.codes
PRODUCT_ID = 0x0001  #: pid.codes' number for tests; a product needs one of its own
PRODUCT_PREFIX = "Hueflight camera"  #: the product string begins so; test numbers are shared
CONTROL_INTERFACE = 0
STREAM_INTERFACE = 1
CONTROL_OUT = 0x02
CONTROL_IN = 0x82
STREAM_IN = 0x81
CONTROL_READ_BYTES = 1024  #: a multiple of the largest packet, so that nothing overflows
