"""Supervision: resets or replaces components that fail, starts components in order, and reports to systemd.

It is a service of the kernel; policies and start rules are values for pure decisions. Its actions are published on the
bus.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.model.wanted.restart_policy import Supervision
    from aiorts.model.wanted.start_rules import ADDED, StartRule, in_order
    from aiorts.supervision.component_place import ContextPlace, place_of
    from aiorts.supervision.readiness import wait_ready
    from aiorts.supervision.start_sequence import Patience
    from aiorts.supervision.supervising import Supervising
    from aiorts.supervision.supervisor import ComponentRecovered, RestartLimitReached, Supervised

late()
