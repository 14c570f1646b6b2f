# SPDX-License-Identifier: Apache-2.0
"""Links to a board: USB, serial line, and the interfaces that every link implements."""
