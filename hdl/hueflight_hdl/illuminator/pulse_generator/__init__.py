# SPDX-License-Identifier: Apache-2.0
"""The pulse generator: fires each LED a set number of ticks after a trigger.

A *tick* is the time step of the outputs. The logic handles `lanes` ticks in each clock; a *lane*
is one of them, lane 0 the earliest. See ``docs/illuminator.md`` for the rules of a train.
"""
