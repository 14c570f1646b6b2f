"""Exit codes that commands share."""

DATA_LOST = 3  #: some data is missing or damaged, as `recover` and `info` report it
FAILED = 1  #: the command could not do what was asked
INTERRUPTED = 130  #: Ctrl-C, as shells report it
