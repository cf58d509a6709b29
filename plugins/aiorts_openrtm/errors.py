"""The error of OpenRTM's files."""

from __future__ import annotations

from aiorts.errors import ConfigurationError


class OpenRTMError(ConfigurationError):
    """A file of OpenRTM cannot be read or made. The message names file and line, the fault and what to do."""

    code = "E-OPENRTM"
