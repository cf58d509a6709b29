"""Samples of several in-ports that belong together, found by their time stamps.

`Synchronizer` reads the in-ports of a component; `matching.py` decides by the stamps alone. The kernel does not know of
it: it uses what every reader of a port uses, and a connector pays nothing for it.
"""

from __future__ import annotations

from aiorts.sync.matching import SynchronizerStatistics
from aiorts.sync.synchronizer import Synchronizer
