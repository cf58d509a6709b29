"""`python -m aiorts` is the command `aiorts`."""

from __future__ import annotations

import os
import sys


def _as_installed() -> None:
    """Take the current folder, which `-m` puts first, from where modules are looked for: a `resource.py` is no plugin.

    Who names a module or a file of that folder has it found by the command that takes the name.
    """
    try:
        here = os.getcwd()
    except OSError:  # it was deleted
        return
    if sys.path[:1] == [here]:
        del sys.path[0]


if __name__ == "__main__":
    _as_installed()
    from aiorts.cli import main

    sys.exit(main())
