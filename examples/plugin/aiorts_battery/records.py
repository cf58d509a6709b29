"""What travels between ports: a record, checked where it is built and never changed afterwards."""

from __future__ import annotations

from aiorts.types import record

__all__ = ("BatteryState",)


@record
class BatteryState:
    """How full a battery is."""

    tm: int = 0
    """When it was measured, nanoseconds since the epoch."""
    voltage: float = 0.0
    """V"""
    charge: float = 0.0
    """0 empty to 1 full."""
    low: bool = False
