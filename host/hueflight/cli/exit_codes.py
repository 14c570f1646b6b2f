"""Exit codes that commands share; `recover` adds 3 for a recording with losses."""

FAILED = 1  #: the command could not do what was asked
INTERRUPTED = 130  #: Ctrl-C, as shells report it
