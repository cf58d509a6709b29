"""Puts a FlexiFilter between two ports that do not fit: `adapt = True` of `Kernel.connect`, `adapt = true` in files.

The filter is worked out from the ports alone; `aiorts check` proposes the same one.
"""

from __future__ import annotations

from aiorts.adapting.inserting import connect_adapted, first_half, inserted, numbered
from aiorts.adapting.proposing import FILTER, Between, between, filter_name, is_accepted, plain_between
