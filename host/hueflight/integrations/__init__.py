# SPDX-License-Identifier: Apache-2.0
"""Adapters for other programs, by which they use a camera or open files of Hueflight.

Each needs the package of its program. They reach a camera through `hueflight.client`, so that a
daemon acquires and records whatever the other program does.
"""
