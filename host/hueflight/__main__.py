# SPDX-License-Identifier: Apache-2.0
"""`python -m hueflight` is the command `hueflight`."""

from hueflight.cli import main

if __name__ == "__main__":
    main()
