"""The text by which a class or function is found again: the reverse of `type_names.py`."""

from __future__ import annotations

import os
import re
import site
import sys
import sysconfig
from pathlib import Path
from typing import Any, Final

from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.extensions.files import is_found_by_python

_LARGEST: Final = 1 << 20
"""Bytes of a file that is looked into."""


def type_text(thing: Any, catalogue: Catalogue, kind: str = "components") -> str:
    """The name that a plugin offers it by, "package.module:Class", or "FILE.py:Class" with the whole path of the file.

    "" where none of them finds it: it was made in a function, or typed into an interpreter.
    """
    module = sys.modules.get(getattr(thing, "__module__", None) or "")
    if module is None:
        return ""
    name = _name_in(module, thing)
    if not name:
        return ""
    for offered, several in catalogue.extensions(kind).items():
        if len(several) == 1 and _is(several[0], thing):
            return offered
    file = getattr(module, "__file__", None)
    if not isinstance(file, str):
        return ""
    path = Path(os.path.realpath(file))
    top = module.__name__.partition(".")[0]
    is_main = module.__name__ == "__main__"
    installed = top != module.__name__ or any(path.is_relative_to(place) for place in _installed_places())
    if installed and not is_main and is_found_by_python(module):
        return f"{module.__name__}:{name}"
    if path.suffix != ".py" or (is_main and not _stands_in(path, name)):
        return ""
    return f"{path}:{name}"


def _name_in(module: Any, thing: Any) -> str:
    """The name by which a module has it."""
    qualified = getattr(thing, "__qualname__", "")
    if qualified and _stands_for(_at(module, qualified), thing):
        return str(qualified)
    return next((name for name, value in vars(module).items() if value is thing), "")


def _at(module: Any, name: str) -> Any:
    found = module
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _is(extension: Extension, thing: Any) -> bool:
    """Whether a plugin offers this very object; of a single file it is better said by the file."""
    home, _, name = extension.target.partition(":")
    module = sys.modules.get(home.strip())
    return module is not None and _stands_for(_at(module, name.strip().split(" ")[0]), thing)


def _stands_for(found: Any, thing: Any) -> bool:
    """Whether it is this object, or the same class of the same file, which was read again for another class of it."""
    if found is thing:
        return True
    both_are_classes = isinstance(found, type) and isinstance(thing, type)
    return both_are_classes and (found.__module__, found.__qualname__) == (thing.__module__, thing.__qualname__)


def _installed_places() -> set[Path]:
    paths = sysconfig.get_paths()
    known = (paths["stdlib"], paths["platstdlib"], paths["purelib"], paths["platlib"], site.getusersitepackages())
    return {Path(os.path.realpath(one)) for one in known}


def _stands_in(path: Path, name: str) -> bool:
    """Whether the text of a file defines it: `__main__` may be an interpreter, into which it was typed."""
    try:
        with path.open("rb") as file:
            text = file.read(_LARGEST).decode("utf-8", "replace")
    except OSError:
        return False
    top = re.escape(name.partition(".")[0])
    return re.search(rf"^(?:(?:async\s+)?def|class)\s+{top}\b|^{top}\s*[:=]", text, re.MULTILINE) is not None
