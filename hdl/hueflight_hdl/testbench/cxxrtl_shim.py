# SPDX-License-Identifier: Apache-2.0
"""The C++ around a CXXRTL model: copies records in and out and steps the clocks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Port:
    """A port of the simulated design."""

    name: str
    width: int
    is_input: bool

    @property
    def words(self) -> int:
        """32-bit words in a record."""
        return -(-self.width // 32)

    @property
    def dtype(self) -> object:
        """Type of the port's field in a record."""
        if self.words <= 2:
            return "<u4" if self.words == 1 else "<u8"
        return ("<u4", (self.words,))


def clock_port(domain: str) -> str:
    """Return the name of a domain's clock input."""
    return f"clock_{domain}"


_SHIM = """\
#include "design.h"
using namespace cxxrtl;

template<size_t N> static inline void put(value<N> &port, const uint32_t *from) {{
    for (size_t i = 0; i < value<N>::chunks; i++) port.data[i] = from[i];
}}
template<size_t N> static inline void get(const value<N> &port, uint32_t *to) {{
    for (size_t i = 0; i < value<N>::chunks; i++) to[i] = port.data[i];
}}
template<size_t N> static inline void get(const wire<N> &port, uint32_t *to) {{
    get(port.curr, to);
}}

struct running {{
    cxxrtl_design::p_top top;
    {phases}
}};

extern "C" void *design_create() {{ return new running(); }}
extern "C" void design_destroy(void *design) {{ delete static_cast<running *>(design); }}

// One evaluation a clock: a domain's edge is a clock that is high and was low before. Outputs
// are taken before the commit, when they still are what they were before the edge.
// Returns whether every evaluation settled at once; a loop of logic would not.
extern "C" bool design_run(void *design, size_t clocks, const uint32_t *in, size_t stride,
                           uint32_t *out) {{
    bool settled = true;
    running &r = *static_cast<running *>(design);
    cxxrtl_design::p_top &top = r.top;
    for (size_t clock = 0; clock < clocks; clock++) {{
{puts}
{edges}
        settled &= top.eval();
{gets}
        top.commit();
        in += stride;
        out += {out_words};
    }}
    return settled;
}}
"""


def shim_source(ports: list[Port], clocks: Mapping[str, int]) -> str:
    """Return the C++ source that drives a model called ``p_top`` of ``design.h``."""
    puts, gets = [], []
    at_in = at_out = 0
    for port in ports:
        if port.is_input:
            puts.append(f"put(top.{_mangle(port.name)}, in + {at_in});")
            at_in += port.words
        else:
            gets.append(f"get(top.{_mangle(port.name)}, out + {at_out});")
            at_out += port.words
    phases, edges = [], []
    for domain, ratio in clocks.items():
        clock = _mangle(clock_port(domain))
        edges.append(f"top.prev_{clock}.set<bool>(false);")
        if ratio == 1:
            edges.append(f"top.{clock}.set<bool>(true);")
        else:
            phases.append(f"unsigned phase_{domain} = 0;")
            edges.append(f"top.{clock}.set<bool>(r.phase_{domain} == 0);")
            edges.append(f"if (++r.phase_{domain} == {ratio}) r.phase_{domain} = 0;")
    indent = "\n" + " " * 8
    return _SHIM.format(
        phases="\n    ".join(phases),
        puts=" " * 8 + indent.join(puts),
        gets=" " * 8 + indent.join(gets),
        edges=" " * 8 + indent.join(edges),
        out_words=max(at_out, 1),
    )


def _mangle(name: str) -> str:
    """Return the C++ name that CXXRTL gives to a port (letters, digits and underscores)."""
    return "p_" + name.replace("_", "__")
