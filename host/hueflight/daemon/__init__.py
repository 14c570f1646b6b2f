# SPDX-License-Identifier: Apache-2.0
"""The capture daemon: runs one camera, reconstructs live, records, and serves a page and an API.

The modules of this package are the core, which knows nothing of HTTP. `hueflight.daemon.http`
serves it, and the folder ``page`` holds the live page.

Words for the data behind one picture: a *block* is a histogram of consecutive frames, as
acquisition delivers it; a *picture* is the sum of the newest blocks with the *image* that is
reconstructed from it; a *message* is a picture encoded for a viewer.
"""

from hueflight.daemon.config import ConfigError, DaemonConfig, RecordingConfig, ServerConfig

__all__ = ["ConfigError", "DaemonConfig", "RecordingConfig", "ServerConfig"]
