"""Parses a moment of a recording: +SECONDS after its first sample, or seconds since 1970."""

from __future__ import annotations

import re
from typing import Final

from aiorts.errors import ConfigurationError

_SECONDS: Final = re.compile(r"\+?\d{1,12}(\.\d{1,9})?", re.ASCII)


def moment_ns(what: str, text: str, start: int) -> int:
    """The log time in ns, exactly.

    Args:
        what: the option or parameter, for the message.
        start: the first log time of the recording.

    Raises:
        ConfigurationError: the text is no moment.
    """
    if not _SECONDS.fullmatch(text):
        raise ConfigurationError(f"{what}: expected +SECONDS or seconds since 1970, got {text[:40]!r}").at(text, 0)
    whole, _, rest = text.removeprefix("+").partition(".")
    ns = int(whole) * 10**9 + int(rest.ljust(9, "0") or "0")
    return start + ns if text.startswith("+") else ns
