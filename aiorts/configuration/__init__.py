"""Configuration files: saves, loads and compares the configuration sets of a whole kernel.

It is a service of the kernel. Loading is all or nothing; a file on disk is the old one or the new one, never half.
"""

from __future__ import annotations

from aiorts.configuration.configuration_files import ConfigurationFiles
from aiorts.configuration.safe_files import read_text, replace_text
