"""Replaces the code of components while they run: all of a context between two cycles, or nothing.

The new instance takes the old one's place, ports, connectors and unread samples. When it fails in its first cycles
everything is taken back.
"""

from __future__ import annotations

from aiorts.reload.fresh_code import code_of, file_of, forget_file
from aiorts.reload.reload_events import ComponentReloaded, Dropped, Reloaded
from aiorts.reload.reloading import check_replaceable, reload
from aiorts.reload.trial import Trial
