"""Links to a board: USB, serial line, and the interfaces that every link implements."""
