# SPDX-License-Identifier: Apache-2.0
"""Gateware of Hueflight: the illuminator, the camera, their boards and how they are built.

Packages, from the bottom up; an import may only go down this list:

- `toolchain`: finds and runs the open tools (yosys, nextpnr, SBY, a C++ compiler).
- `common`: counters, clock-domain crossings, the version of the gateware.
- `control`: requests and responses, the register file.
- `link`: serial line, USB 2, FT601 and Opal Kelly's host interface.
- `camera` and `illuminator`: the two designs. Neither imports the other.
- `boards`: pins, clocks and PLLs; each design on each board.
- `testbench`: compiled simulation, and models of what surrounds a design.
- `proofs`: statements that are formally verified.
- `build`: bitstreams, timing reports and vendor projects.
- `cli`: the command ``hueflight-hdl``.
"""
