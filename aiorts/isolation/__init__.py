"""Components that run in processes of their own.

`Kernel.create_isolated` starts a process with a kernel in it, makes the component there, and gives a stand-in of it to
this kernel. Connectors at the stand-in's ports are links. The stand-in has the lifecycle, parameters and errors of the
component in the process. The end of the process is a failure of the component like any other.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.isolation.handover import give_state, hold, packed, release, state_of, taken
    from aiorts.isolation.isolating import Isolation
    from aiorts.isolation.messages import MARK, OPERATE, REPORT, First, Report, asked, done, refused
    from aiorts.isolation.moving import exchange, hold_at, make_replacement, move
    from aiorts.isolation.placing import given_of, placed
    from aiorts.isolation.ports import described, fail, follow
    from aiorts.isolation.stand_in import RemoteComponent
    from aiorts.processes import Limits

late()
