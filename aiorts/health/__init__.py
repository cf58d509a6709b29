"""The health of a kernel: counts of its connectors, contexts and components over windows of time, while it runs.

`aiorts.model.health` compares two windows.
"""

from __future__ import annotations

from aiorts.health.measuring import Health
