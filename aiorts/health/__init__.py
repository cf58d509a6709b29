"""How a kernel does: its connectors, contexts and components are counted over windows of time, beside what runs.

`aiorts.model.health` compares two windows.
"""

from __future__ import annotations

from aiorts.health.measuring import Health
