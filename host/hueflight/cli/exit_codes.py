# SPDX-License-Identifier: Apache-2.0
"""Exit codes that commands share."""

DATA_LOST = 3  #: some data is missing or damaged, as `recover` and `info` report it
FAILED = 1  #: the command could not do what was asked
NO_LONGER_HOLDS = 4  #: `check` found that a calibration no longer describes the instrument
INTERRUPTED = 130  #: Ctrl-C, as shells report it
