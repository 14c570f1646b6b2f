# SPDX-License-Identifier: Apache-2.0
"""Links between a board and its host: serial line, USB 2, FT601, Opal Kelly's interface."""
