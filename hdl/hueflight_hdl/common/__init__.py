"""Parts that both boards use: counters, clock-domain crossings and the version of the gateware."""
