"""The pulse generator: triggers in, LED pulses out, to the tick.

A *tick* is the time step of the outputs; a *lane* is one of the `lanes` ticks that the fabric
handles in one clock, lane 0 first. See ``docs/illuminator.md`` for the rules of a train.
"""
