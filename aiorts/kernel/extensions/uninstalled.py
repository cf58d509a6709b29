"""The extensions of a project that are not installed: its `pyproject.toml` was changed since, or it never was."""

from __future__ import annotations

import os
from pathlib import Path

from aiorts.kernel.extensions.catalogue import KINDS, Catalogue


def named_in_project(name: str, *kinds: str) -> str:
    """A remedy where the project of the current folder, or of one above, offers this name; "" where none does.

    Args:
        kinds: kinds of extensions to look for; all by default. Upper and lower case are the same.
    """
    try:
        here = Path.cwd()
        folder = next((one for one in (here, *here.parents) if (one / "pyproject.toml").is_file()), None)
    except OSError:  # the current folder was deleted
        return ""
    if folder is None:
        return ""
    catalogue = Catalogue((folder,))
    offers = (one for kind in kinds or KINDS for found in catalogue.extensions(kind).values() for one in found)
    if not any(one.folder == folder and one.name.lower() == name.lower() for one in offers):
        return ""
    place = os.path.relpath(folder)
    return f"{os.path.normpath(os.path.join(place, 'pyproject.toml'))} names it: pip install -e {place} again"
