"""The error of OpenRTM's files."""

from __future__ import annotations

from aiorts.errors import ConfigurationError


class OpenRTMError(ConfigurationError):
    """A file of OpenRTM cannot be read, or not be made: names file and line, what is wrong and what to do."""

    code = "E-OPENRTM"
