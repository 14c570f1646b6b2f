"""Links: what carries bytes between board and host."""
