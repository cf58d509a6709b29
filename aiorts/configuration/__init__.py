"""Configuration files: saves, loads and compares the configuration sets of a whole kernel.

It is a service of the kernel. Loading is all or nothing; a file on disk is the old one or the new one, never half.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING
from aiorts.late import late as _late

if TYPE_CHECKING:
    from aiorts.configuration.configuration_files import ConfigurationFiles
    from aiorts.configuration.safe_files import read_text, replace_text

_late(
    globals(),
    {
        "aiorts.configuration.configuration_files": "ConfigurationFiles",
        "aiorts.configuration.safe_files": "read_text replace_text",
    },
)
