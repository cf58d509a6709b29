"""Service ports: interfaces that components provide and require, and the calls between them.

Service ports are a kind of port (`PortDeclaration`), so the kernel adds and connects them without knowing them.
`Provided` and `Required` declare, a proxy calls.
"""

from __future__ import annotations

from aiorts.late import TYPE_CHECKING, late

if TYPE_CHECKING:
    from aiorts.services.goal_keeper import GoalAccepted, GoalEnded, GoalKeeper
    from aiorts.services.goals import Goal
    from aiorts.services.outside_caller import OutsideCaller
    from aiorts.services.service_arguments import GoalTypes, goal_types
    from aiorts.services.service_call import seconds_left
    from aiorts.services.service_ends import Provided, Required, idempotent
    from aiorts.services.service_heritage import ServiceHeritage
    from aiorts.services.service_port import Made, Service, ServiceConnector, ServiceEnd, ServicePort, is_service
    from aiorts.services.service_proxy import Relayed
    from aiorts.services.service_wiring import fault_of, pairs_of

late()
