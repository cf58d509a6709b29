"""Places of boxes in files: one for each kernel in the user's state folder, and one next to a system file.

The names of the files come from the command line and from kernels, never from a page.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Final

from aiorts.layout import LARGEST_LAYOUT, Places, places_of, text_of_places

_MOST: Final = 500
"""The most files in the state folder; beyond that the oldest are removed."""
_BROKEN: Final = ".broken"


class PlaceFiles:
    """Reads and writes the places of kernels. A file that is broken is renamed, and reported.

    Args:
        folder: for a file of each kernel; None: there is none.
        beside: the file of the one kernel that is shown, written when a user has placed its boxes; None: there is none.
        report: is called with a text about a file that cannot be used.
    """

    def __init__(self, folder: Path | None, beside: Path | None, report: Callable[[str], object]) -> None:
        self._folder, self._beside, self._report = folder, beside, report
        self._unusable: set[Path] = set()

    def read(self, lasting: str) -> Places:
        """The places that were written for a kernel; the file next to the system file goes before the folder's."""
        found = Places()
        for path in (self._path(lasting), self._beside):
            known = self._of(path) if path is not None else None
            if known is not None:
                found.boxes |= known.boxes
                found.by_hand = found.by_hand - known.boxes.keys() | known.by_hand
        return found

    def write(self, lasting: str, places: Places, *, is_of_user: bool) -> None:
        """Write the places of a kernel.

        Args:
            is_of_user: whether a user has placed boxes: then the file next to the system's is written, too.
        """
        data = text_of_places(lasting, places).encode()
        if len(data) > LARGEST_LAYOUT:
            return
        if (path := self._path(lasting)) is not None and self._folder is not None:
            self._put(path, data)
            _thin_out(self._folder)
        if is_of_user and self._beside is not None:
            self._put(self._beside, data)

    def _path(self, lasting: str) -> Path | None:
        if self._folder is None:
            return None
        readable = "".join(c if c.isalnum() else "-" for c in lasting.rpartition("/")[2])[-40:]
        return self._folder / f"{readable}-{sha256(lasting.encode()).hexdigest()[:16]}.layout.json"

    def _of(self, path: Path) -> Places | None:
        """The places in a file; None where there is none, or it is broken."""
        try:
            if not path.is_file():
                return None
            with path.open("rb") as file:
                data = file.read(LARGEST_LAYOUT + 1)
            return places_of(data)
        except OSError as error:
            self._refuse(path, f"{path}: cannot be read: {error.strerror}")
        except ValueError as error:
            kept = path.with_name(path.name + _BROKEN)
            try:
                path.replace(kept)
            except OSError:
                self._refuse(path, f"{path}: {error}; it is left as it is, and not used")
            else:
                self._report(f"{path}: {error}; it is called {kept.name} now, and not used")
        return None

    def _put(self, path: Path, data: bytes) -> None:
        """Write a file whole or not at all."""
        if path in self._unusable:
            return
        draft = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            if path is not self._beside:
                path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            try:
                draft.write_bytes(data)
                draft.replace(path)
            finally:
                draft.unlink(missing_ok=True)
        except OSError as error:
            self._refuse(path, f"{path}: cannot be written: {error.strerror}; places are not kept there")

    def _refuse(self, path: Path, why: str) -> None:
        self._unusable.add(path)
        self._report(why)


def state_folder() -> Path | None:
    """The user's folder for places; None where there is no home."""
    base = os.environ.get("XDG_STATE_HOME", "")
    try:
        return (Path(base) if os.path.isabs(base) else Path.home() / ".local" / "state") / "aiorts" / "layouts"
    except RuntimeError:
        return None


def _thin_out(folder: Path) -> None:
    """Remove the oldest files of kernels, where there are too many."""
    files = list(folder.glob("*.layout.json"))
    if len(files) > _MOST:
        for path in sorted(files, key=lambda path: path.stat().st_mtime)[:-_MOST]:
            path.unlink(missing_ok=True)
