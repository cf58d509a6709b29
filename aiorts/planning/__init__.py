"""A kernel is read into `Wanted`, which becomes a system file, or is compared with another and made equal to it.

It is a service of the kernel, which keeps what a system file said that nothing else in the kernel knows.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.planning.canon import Canon, service_connection, table, whole, without_provenance
    from aiorts.planning.component_rows import put_in_force
    from aiorts.planning.planning import Planning
    from aiorts.planning.reading import wanted_of
    from aiorts.planning.setting import ACTIVE, Setting, setting_alone
    from aiorts.planning.switching import switch, tops

late()
