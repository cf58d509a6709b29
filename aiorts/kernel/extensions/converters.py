"""A converter as text: `FILE.py:function`, `package.module:function`, or a name that a plugin offers and its own text.

System files and `Kernel.connect` ask here. It finds what is meant and imports nothing; `loading.py` loads it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, cast

from aiorts.errors import PluginError
from aiorts.kernel.extensions.catalogue import Catalogue, Extension
from aiorts.kernel.extensions.loading import load_object_aside
from aiorts.kernel.extensions.type_names import extension_of, shown
from aiorts.model.converter import Converter, function_fault

if TYPE_CHECKING:
    from aiorts.clock import Clock
    from aiorts.model.converter import Maker

_KIND: Final = "converters"
_IN_CODE: Final = re.compile(r"(.*\.py|[\w.]+):[\w.]+")


def converter_extension(
    text: str,
    catalogue: Catalogue,
    places: Iterable[Path] = (Path(),),
    allow: Callable[[Path], object] | None = None,
) -> Extension:
    """The extension that a text names, to be loaded. The arguments are those of `extension_of`.

    Raises:
        PluginError: there is no such file, module or offer (near names are given), or it is none of the three forms.
    """
    name = text.partition(" ")[0]
    if name in catalogue.extensions(_KIND):
        return catalogue.find(_KIND, name)
    if ":" not in text:
        try:
            return catalogue.find(_KIND, name)
        except PluginError as error:
            raise PluginError(f"{error}; a function is written FILE.py:function or package.module:function") from None
    if not _IN_CODE.fullmatch(text):
        offered = ", ".join(catalogue.extensions(_KIND)) or "none"
        raise PluginError(
            f"{shown(text)}: expected FILE.py:function, package.module:function, or the name of a converter with its "
            f"text behind it; there are {offered}"
        )
    return extension_of(text, catalogue, places, allow, _KIND)


async def load_converter(text: str, catalogue: Catalogue, clock: Clock) -> str:
    """The converter of a text, loaded in a thread; one that has been found already, or names nothing, as it is.

    Raises:
        PluginError: what `converter_extension` and `converter_of` raise.
    """
    if isinstance(text, Converter) or not text.strip():
        return text
    text = text.strip()
    try:
        extension = converter_extension(text, catalogue)
        return converter_of(text, extension, await load_object_aside(extension, clock))
    except PluginError as error:
        raise PluginError(f"convert: {error}") from error.__cause__


def converter_of(text: str, extension: Extension, found: Any) -> Converter:
    """The converter that a text means, of what its extension was loaded as.

    Raises:
        PluginError: that is no plain function of one sample, or nothing that makes one.
    """
    if extension.source:
        if not callable(found):
            kind = type(found).__name__
            raise PluginError(f"{extension.described}: a {kind} makes no converter; offer a function of text and types")
        return Converter(text, of_text=True, make=cast("Maker", found))
    if fault := function_fault(found):
        raise PluginError(f"{extension.described}: {fault}")
    return Converter(text, found, of_text=True)
