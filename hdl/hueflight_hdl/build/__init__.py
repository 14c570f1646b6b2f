"""Bitstreams: synthesis, placement and routing, timing reports and vendor projects."""
