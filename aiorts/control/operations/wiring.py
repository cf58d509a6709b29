"""Operations on connectors: list them, connect and disconnect ports."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Generator, Mapping
from dataclasses import field, replace
from functools import partial
from itertools import accumulate
from typing import Any, Final

from aiorts.control.operation import Operation, Right, converters_read
from aiorts.control.operations.known import absent
from aiorts.control.session import Session
from aiorts.control.turns import answer_in_turns
from aiorts.errors import AbsentError, LinkError, WiringError
from aiorts.kernel.ports import PortDeclaration
from aiorts.late import dataclass
from aiorts.model.names import names_kernel
from aiorts.model.plain import empty
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics
from aiorts.model.service_profile import ServiceConnectorProfile, ServiceStatistics
from aiorts.observe import visible


@dataclass(frozen=True, slots=True)
class Wiring:
    """Ports to connect."""

    ports: tuple[str, ...]
    """Paths of ports; for a port of another kernel, the path begins with the name by which links reach that kernel."""
    options: Mapping[str, Any] = field(default_factory=empty)
    """The options of `Kernel.connect`."""


@dataclass(frozen=True, slots=True)
class Wires:
    """Connectors: by name, or all at a port or component, or all between two."""

    names: tuple[str, ...] = ()
    at: tuple[str, ...] = ()
    """One or two paths of ports or names of components. Where connectors are listed, no name and no path means all."""
    both_ends: bool = False
    """Whether a list asks the other kernel of each link, too."""


@dataclass(frozen=True, slots=True)
class Wire:
    """A connector of data ports, or of service ports."""

    name: str
    ports: tuple[str, ...]
    options: ConnectorProfile | None = None
    """The options in force."""
    ledger: ConnectorStatistics | None = None
    both_ends: str = ""
    """The ledger of a link from the writer to the reader, if requested, or the reason why it is not known now."""
    waiting: int | None = None
    """The samples of the ledger in `both_ends` that wait at either end: to be sent, or to be read."""
    read: Mapping[str, tuple[int, ...]] | None = None
    """The figures of the reader's end of a link, if requested and measured: "age", the age of samples at the read, by
    their stamps, "within", the possible error of the age, and "waited", the time in the reader's buffer. Each is the
    number of samples, p50, p99 and maximum in nanoseconds. None: the reader's end has not answered, or is of a release
    without these figures."""
    service: ServiceConnectorProfile | None = None
    """The profile of a connector of service ports: which port answers which."""
    calls: ServiceStatistics | None = None
    between: str = ""
    """The component that `adapt` inserted before the reader, as a command line names it."""


@dataclass(frozen=True, slots=True)
class Fitting:
    """A port for which matching ports are listed."""

    port: str
    """ "component.port"."""
    fitting: bool = False
    """Whether to leave out the ports that do not fit."""


async def _connect(session: Session, given: Wiring) -> tuple[Wire, ...]:
    kernel = session.kernel
    for path in given.ports:
        if not kernel.registry.is_elsewhere(path):
            _check_port(session, path)
    if len(given.ports) < 2:
        raise WiringError(f"{', '.join(given.ports) or 'nothing'}: connect takes two ports at least")
    one, two, *more = given.ports
    made: Any = await kernel.connect(one, two, *more, **given.options)
    return tuple(wire for each in (made if more else (made,)) for wire in _wires(session, each, given))


def _wires(session: Session, connector: Any, given: Wiring) -> tuple[Wire, ...]:
    """A new connector; with `adapt` also the connector to the inserted component, where one was inserted."""
    wire = _wire(connector)
    if not given.options.get("adapt"):
        return (wire,)
    from aiorts.adapting import inserted  # late: few connectors have a filter between

    found = inserted(session.kernel, connector, given.ports)
    return (wire,) if found is None else (_wire(found[0]), replace(wire, between=found[1]))


async def _disconnect(session: Session, given: Wires) -> tuple[str, ...]:
    if not given.names and not given.at:
        raise WiringError("disconnect: say a connector, a port, a component, or two of them")
    found = _found(session, given)
    if not found:
        raise AbsentError(f"{' and '.join(given.at)}: no connector there; `aiorts con` lists them")
    for one in found:
        await session.kernel.disconnect(one)
    return tuple(one.name for one in found)


async def _connectors(session: Session, given: Wires) -> tuple[Wire, ...]:
    found = _found(session, given)
    wires = [_wire(one) for one in found]
    if not given.both_ends:
        return tuple(wires)
    return tuple(await asyncio.gather(*map(partial(_both_ends, session), found, wires)))


async def _both_ends(session: Session, connector: Any, wire: Wire) -> Wire:
    far = session.kernel.connections.far
    if far is None or wire.options is None or not wire.options.far_end:
        return wire
    try:
        ledger = await far.ledger(connector)
    except LinkError as error:
        return replace(wire, both_ends=f"not known: {error}")
    read = None if ledger.read is None else {what: tuple(spans) for what, spans in ledger.read.items()}
    return replace(wire, both_ends=str(ledger), waiting=ledger.buffered, read=read)


def _fits(session: Session, given: Fitting) -> Mapping[str, str] | Awaitable[Mapping[str, str]]:
    kernel, made = session.kernel, dict[str, str]()
    _check_port(session, given.port)
    port = kernel.find(given.port)
    if not isinstance(port, PortDeclaration):
        raise WiringError(f"{given.port}: is a component; say one of its ports")

    def look() -> Generator[None, None, Mapping[str, str]]:
        for component in tuple(kernel.components.values()):
            for one in tuple(component.ports.values()) if visible(kernel, component) else ():
                why = "" if one is port else kernel.connections.fault(port, one)
                if one is not port and not (why and given.fitting):
                    made[one.path] = why
                yield
        return made

    return answer_in_turns(kernel, look())


def _all(session: Session) -> dict[str, Any]:
    return {**session.kernel.connectors, **session.kernel.service_connectors}


def _found(session: Session, given: Wires) -> list[Any]:
    known = _all(session)
    for name in given.names:
        if name not in known:
            raise absent(f"{name:.80}: no such connector", name, known)
    for path in given.at:
        if not names_kernel(path):
            _check_port(session, path)
        elif path not in (there := {place for one in known.values() for place in places_of(one)}):
            raise absent(f"{path:.80}: no connector leads there", path, filter(names_kernel, there))
    if given.names:
        return [known[name] for name in dict.fromkeys(given.names)]
    at = frozenset(given.at)
    return [one for one in known.values() if not at or at <= places_of(one)]


def _check_port(session: Session, path: str) -> None:
    """Raise AbsentError unless the path is a component, or a port of one."""
    name, _, port = path.partition(".")
    known = session.kernel.components
    if name not in known:
        raise absent(f"{path:.80}: no such component", name, known)
    ports = known[name].ports
    if port and port.partition(".")[0] not in ports:
        raise absent(f"{path:.80}: {name} has no such port", port, ports)


def _wire(one: Any) -> Wire:
    profile = one.profile
    if isinstance(profile, ConnectorProfile):
        return Wire(one.name, ports_of(one), profile, one.statistics)
    return Wire(one.name, profile.ports, service=profile, calls=one.statistics)


def ports_of(connector: Any) -> tuple[str, ...]:
    """The paths of the connector's own ports, of data ports the writer's first; one call may connect more ports."""
    if isinstance(connector.profile, ConnectorProfile):
        return connector.out.path, connector.in_.path
    return tuple(connector.profile.ports)


def places_of(connector: Any) -> set[str]:
    """The paths by which clients name the ends of a connector: its ports, and each leading part of their paths."""
    return {path for port in ports_of(connector) for path in accumulate(port.split("."), "{}.{}".format)}


def _needed(given: Wiring) -> Right:
    return Right.CODE if converters_read(given.options) else Right.OPERATE


ROWS: Final = (
    Operation("connect", "Connect ports.", Wiring, tuple[Wire, ...], Right.OPERATE, _connect, demands=_needed),
    Operation(
        "connectors",
        "Connectors with options and ledger.",
        Wires,
        tuple[Wire, ...],
        Right.VIEW,
        _connectors,
        idempotent=True,
    ),
    Operation(
        "fits",
        "The ports that can be connected with a port, and of each other one why it cannot.",
        Fitting,
        Mapping[str, str],
        Right.VIEW,
        _fits,
        idempotent=True,
    ),
    Operation("disconnect", "End connectors.", Wires, tuple[str, ...], Right.OPERATE, _disconnect),
)
