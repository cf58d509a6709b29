"""Finds the faults of each connection once the ports at its ends are known; connects nothing."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from aiorts.errors import SystemFileError, WiringError
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.wiring import converter_between, pair_faults
from aiorts.kernel.quality import FEATURES
from aiorts.model.names import names_kernel
from aiorts.model.options import doubts, idle, link_options, transport_notice, without_effect
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.services import ServicePort, fault_of
from aiorts.spelling import nearest, suggestion
from aiorts.system.checks.adapt import adaptation
from aiorts.system.checks.draft import Draft
from aiorts.system.checks.findings import Said
from aiorts.system.file.pairs import ConnectedPairs
from aiorts.system.file.survey import Survey
from aiorts.system.text.places import Key
from aiorts.types import has_tm
from aiorts.wire import LINK, excess


def joint_findings(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    """The findings about ports that do not exist, ends that do not go together, and pairs connected twice."""
    joined = ConnectedPairs()
    counts: dict[str, int] = {}
    names: dict[str, int] = {}
    unsure: set[str] = set()
    yield from _transport(found.system.connections)
    for connection in found.system.connections:
        ports: list[Port[Any] | None] = []
        for number, path in enumerate(connection.ports):
            port, said = _port(found, drafts, connection, number, path, unsure)
            ports.append(port)
            if said is not None:
                yield said
        made = found.profiles.get(connection.number)
        vain = () if made is None else idle(connection.options, made[0])
        for option, text in (*doubts(connection.options), *vain):
            yield Said("warning", "W-OPTION", (*_key(connection), *option.split(".")), text, of_key=option != "name")
        yield from _link(found, connection, from_reader=any(isinstance(port, InPort) for port in ports))
        yield from _too_large(connection, ports)
        known = [port for port in ports if port is not None]
        if len(known) == len(ports):
            yield from _ends(found, drafts, connection, known)
            yield from _limits(found, connection, known, joined, counts)
        name = connection.options.get("name")
        if (
            isinstance(name, str)
            and len(connection.ports) == 2
            and names.setdefault(name, connection.number) != connection.number
        ):
            what = f"connections[{names[name]}] has the name {name!r} already; choose another"
            yield Said("error", WiringError.code, (*_key(connection), "name"), what)


def feature_findings(found: Survey) -> Iterator[Said]:
    """The findings about options that ports of components in real-time threads do not support."""
    threads = {
        member: context.kind
        for name, context in found.contexts.items()
        if not context.features and name in found.system.contexts
        for member in found.system.contexts[name].members
    }
    for connection in found.system.connections:
        if connection.number not in found.profiles:
            continue
        profile, _ = found.profiles[connection.number]
        ends = [path.partition(".")[0] for path in connection.ports]
        for feature in FEATURES:
            if feature.wanted(profile) and (end := next((one for one in ends if one in threads), None)):
                what = (
                    f"{end} runs in a {threads[end]} context, which has no such connector at its ports; "
                    "take it away, or take another kind of context"
                )
                option = feature.key.partition(" ")[0]
                yield Said("error", WiringError.code, (*_key(connection), option), what, of_key=True)


def _transport(connections: Iterable[ConnectionEntry]) -> Iterator[Said]:
    """The finding about options for OpenRTM's transports: one for the whole file, at the first such option."""
    keys: dict[str, Key] = {}
    for connection in connections:
        for option in without_effect(connection.options):
            keys.setdefault(option, (*_key(connection), *option.split(".")))
    if keys:
        yield Said("warning", "W-TRANSPORT", next(iter(keys.values())), transport_notice(tuple(keys)), of_key=True)


def _link(found: Survey, connection: ConnectionEntry, *, from_reader: bool) -> Iterator[Said]:
    """The findings about a link: options that the other kernel has to implement, and ports that are not known yet."""
    far = [number for number, path in enumerate(connection.ports) if names_kernel(path)]
    if far and from_reader and connection.number in found.profiles:
        try:
            link_options("", connection.options, from_reader=True)
        except WiringError as error:
            yield Said("error", WiringError.code, _key(connection), str(error).removeprefix(": "), of_key=True)
    for number, path in enumerate(connection.ports):
        if number in far:
            said = [key for key in connection.options if key.endswith(("subscription", "subscription_type", "io_mode"))]
            how = "" if said else "; samples of data ports go as new/all, so a write never waits for a round trip"
            what = f"{path} is in another kernel: whether it fits is known when that kernel is there{how}"
            yield Said("note", "N-LINK", end_key(connection, number), what)


def _too_large(connection: ConnectionEntry, ports: Iterable[Port[Any] | None]) -> Iterator[Said]:
    """The findings about ports at this end whose samples may exceed the limits of a link's other end."""
    if not any(map(names_kernel, connection.ports)):
        return
    for number, port in enumerate(ports):
        if isinstance(port, OutPort | InPort) and (said := excess(port.type, LINK)):
            text = f"a link takes no sample of {connection.ports[number]} with {said}: it would be dropped and counted"
            yield Said("note", "N-LIMITS", end_key(connection, number), text)


def _key(connection: ConnectionEntry) -> Key:
    return ("connections", connection.number - 1)


def end_key(connection: ConnectionEntry, number: int) -> Key:
    """The key of the path of port `number`: 0 is the port under `from`."""
    return (*_key(connection), "from") if number == 0 else (*_key(connection), "to", number - 1)


def _port(
    found: Survey, drafts: Mapping[str, Draft], connection: ConnectionEntry, number: int, path: str, unsure: set[str]
) -> tuple[Port[Any] | None, Said | None]:
    component, _, name = path.partition(".")
    draft = drafts.get(component)
    if draft is None or draft.error is not None:
        return None, None  # has been reported with the component
    port = draft.ports.get(name)
    if port is not None:
        return port, None
    key = end_key(connection, number)
    if draft.complete or nearest(name, draft.ports):
        what = f"{component} has no port {name!r}; {suggestion(name, draft.ports)}"
        return None, Said("error", SystemFileError.code, key, what)
    if component in unsure:
        return None, None
    unsure.add(component)
    kind = found.types[component].__name__ if component in found.types else f"a member of {component}"
    composite = found.system.composites.get(component)
    if composite is not None and any(map(names_kernel, composite.members)):
        what = f"whether {component} has {name!r} is known when the kernels of its members elsewhere run"
        return None, Said("note", "N-PORTS", key, what)
    what = f"{kind} may make {name!r} in on_initialize, which is not run here; a method make_ports would tell"
    return None, Said("note", "N-PORTS", key, what)


def _ends(
    found: Survey, drafts: Mapping[str, Draft], connection: ConnectionEntry, ports: list[Port[Any]]
) -> Iterator[Said]:
    services = [port for port in ports if isinstance(port, ServicePort)]
    if services:
        yield from _services(connection, ports, services)
        return
    outs = [port for port in ports if isinstance(port, OutPort)]
    ins = [port for port in ports if isinstance(port, InPort)]
    if not outs or not ins:
        word = "in-ports" if ins else "out-ports"
        what = f"{' and '.join(port.path for port in ports)} are {word}; connect an out-port with an in-port"
        yield Said("error", WiringError.code, end_key(connection, 1), what)
        return
    if not isinstance(ports[0], OutPort):
        what = f"{ports[0].path} is an in-port; write the out-port under from"
        yield Said("warning", "W-TURNED", end_key(connection, 0), what)
    profile = found.profiles[connection.number][0] if connection.number in found.profiles else None
    converter = None if profile is None else profile.convert
    for out in outs:
        for in_ in ins:
            key = end_key(connection, ports.index(in_))
            told = False
            if converter is not None:
                try:
                    converter_between(out, in_, converter)
                except WiringError as error:
                    text = str(error).removeprefix(f"{out.path} -> {in_.path}: ")
                    yield Said("error", WiringError.code, (*_key(connection), "convert"), text)
            for fault in pair_faults(out, in_, converted="convert" in connection.options):
                # One filter mends all faults between the two ports, so it is suggested once.
                mended = None if told else adaptation(found, connection, out, in_)
                text = fault.removeprefix(f"{out.path} -> {in_.path}: ")
                if mended is not None:
                    told = True
                    text = f"{text.rpartition('; ')[0]}; {mended.remedy}"
                yield Said("error", WiringError.code, key, text, suggestion="" if mended is None else mended.text)
    stamped = () if profile is None or profile.stamp is None else outs if converter is None else ins
    for port in stamped:
        if not has_tm(port.type):
            does = "sends" if port in outs else "takes"
            what = f"{port.path} {does} {port.type.__name__}, which has no field tm to put it in; take it away"
            yield Said("error", WiringError.code, (*_key(connection), "stamp"), what)


def _services(connection: ConnectionEntry, ports: list[Port[Any]], services: list[ServicePort]) -> Iterator[Said]:
    if len(services) < len(ports):
        what = f"{' and '.join(port.path for port in ports)}: a data port and a service port; connect like with like"
        yield Said("error", WiringError.code, end_key(connection, 1), what)
    elif (fault := fault_of(services, connection.options)) is not None:
        text = str(fault).removeprefix(f"{' -> '.join(port.path for port in ports)}: ")
        yield Said("error", fault.code, end_key(connection, 1), text)


def _limits(
    found: Survey,
    connection: ConnectionEntry,
    ports: list[Port[Any]],
    joined: ConnectedPairs,
    counts: dict[str, int],
) -> Iterator[Said]:
    """The findings about pairs that are connected already, and ports with more than `max_connectors` connectors."""
    _, limits = found.profiles.get(connection.number, (None, None))
    for out in (port for port in ports if isinstance(port, OutPort)):
        for in_ in (port for port in ports if isinstance(port, InPort)):
            if (fault := joined.fault(out.path, in_.path, connection.number, limits)) is not None:
                yield Said("error", fault.code, _key(connection), str(fault), of_key=True)
            for port in (out, in_):
                counts[port.path] = counts.get(port.path, 0) + 1
                if port.max_connectors is not None and counts[port.path] == port.max_connectors + 1:
                    what = f"{port.path} takes {port.max_connectors} connectors at the most; take this one away"
                    yield Said("error", WiringError.code, _key(connection), what, of_key=True)
