"""`python -m aiorts` is the command `aiorts`."""

from __future__ import annotations

import sys

from aiorts.cli import main

if __name__ == "__main__":
    sys.exit(main())
