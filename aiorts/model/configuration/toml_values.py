"""Values as TOML writes them."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Mapping
from typing import Any

from aiorts.errors import ConfigurationError


def value_text(where: str, value: Any) -> str:
    """The text of a parameter's value; None is `{none = true}`.

    Raises:
        ConfigurationError: the value cannot be written, such as text that is no UTF-8; `where` is in the message.
    """
    if value is None:
        return "{none = true}"
    if isinstance(value, enum.Enum):
        return basic_string(value.name)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, tuple | list):
        return f"[{', '.join(value_text(where, item) for item in value)}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{basic_string(key)} = {value_text(where, item)}' for key, item in value.items())}}}"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    try:
        text = str(value)
    except ValueError as error:  # an integer with more digits than Python writes
        raise ConfigurationError(f"{where}: cannot be saved: {error}") from None
    return text if isinstance(value, int) else basic_string(text, where)


def basic_string(text: str, where: str = "") -> str:
    """A basic string of TOML: as JSON writes it, which escapes everything that TOML wants escaped, but for DEL.

    Raises:
        ConfigurationError: the text is no UTF-8; `where` is in the message.
    """
    try:
        text.encode()
    except ValueError:
        why = "is no UTF-8, which TOML is; rename what it names, or save the file in that folder"
        raise ConfigurationError(f"{where}{': ' if where else ''}cannot be saved: {text!r} {why}") from None
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
