"""The findings that need the whole system: components that never run, open ports, cycles that never rest, writers that
wait for themselves. Pure: they are found from a survey and drafts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from aiorts.contexts import EventContext
from aiorts.errors import SLOW_READER, StateError, SystemFileError, WiringError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.ports import OutPort, Port
from aiorts.model.buffer import FullPolicy
from aiorts.model.names import names_kernel
from aiorts.model.options import connector_profile
from aiorts.model.policy import Dataflow, Push, Subscription
from aiorts.model.profile import ConnectorProfile
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.services import ServicePort
from aiorts.system.checks.circles import circle_findings
from aiorts.system.checks.cycles import cycles
from aiorts.system.checks.draft import Draft
from aiorts.system.checks.findings import Said
from aiorts.system.checks.surveyed import connected_later, contexts_of, wakes
from aiorts.system.file.families import parts, root, unstartable
from aiorts.system.file.survey import Survey
from aiorts.system.text.reading import spelled
from aiorts.types import is_mutable, type_name
from aiorts.wire import excess

NOTHING_RUNS = "no context runs anything; add [contexts.NAME] with kind and members"
_MOST_LISTED = 6
"""The most ports that a message lists."""


def whole_findings(found: Survey, drafts: Mapping[str, Draft], *, whole: bool) -> Iterator[Said]:
    """Findings about several parts together; `whole` is False if parts were left out: then none counts as missing."""
    if whole and not (found.system.components or found.system.composites):
        text = "there are no components, and nothing to run; write [components.NAME] with a type"
        yield Said("warning", "W-EMPTY", ("schema",), text, of_key=True)
    if whole:
        yield from _unused(found)
        for key, text in unstartable(found.system):
            yield Said("error", SystemFileError.code, key, text)
        yield from _open_ports(found, drafts)
        yield from _unwoken(found, drafts)
    yield from _unsaid_files(found)
    yield from _too_many(found)
    yield from _left_alone(found)
    yield from _mutable(found, drafts)
    yield from _too_large(found, drafts)
    yield from circle_findings(found, drafts, whole=whole)
    yield from _meetings(found)
    yield from _standoffs(found)
    yield from _waits(found)
    yield from _outrun(found, drafts)


def _unused(found: Survey) -> Iterator[Said]:
    run = {member for context in found.system.contexts.values() for member in context.members}
    composites = found.system.composites
    elsewhere = any(names_kernel(member) for entry in composites.values() for member in entry.members)
    if found.system.components and not run and not elsewhere:
        names = ", ".join(f'"{name}"' for name in found.system.components)
        mended = f'[contexts.main]\nkind = "periodic"\nrate = 10.0\nmembers = [{names}]'
        yield Said("error", SystemFileError.code, (), NOTHING_RUNS, suggestion=mended)
        return
    outside = [name for name in composites if not run.intersection(parts(composites, name)) and parts(composites, name)]
    for name in outside:
        if root(composites, name) == name:
            text = f"{name} is in no context and none of its members runs; name it among the members of one"
            yield Said("warning", "W-UNUSED", ("composites", name), text, of_key=True)
    told = {part for name in outside for part in parts(composites, name)}
    for name in found.system.components:
        if name not in run and name not in told:
            text = f"{name} is in no context and never runs; name it among the members of one, or take it away"
            yield Said("warning", "W-UNUSED", ("components", name), text, of_key=True)


def _unsaid_files(found: Survey) -> Iterator[Said]:
    """The findings about path parameters that do not declare whether the file is read or written."""
    for name, cls in found.types.items():
        for spec in declarations(cls).parameters.values():
            if spec.is_path and not spec.file:
                text = (
                    f"{spec.name} is a path, and its class does not say what is done with the file; declare it with "
                    'Param(..., file="read") or file="write", which it counts as'
                )
                yield Said("warning", "W-FILE", ("components", name), text, of_key=True)


def _listed(parts: Sequence[str]) -> str:
    """The first parts, and the number of the others."""
    more = len(parts) - _MOST_LISTED
    return ", ".join(parts[:_MOST_LISTED]) + (f" and {more} more" if more > 0 else "")


def _open_ports(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    used = {path for connection in found.system.connections for path in connection.ports}
    comes = connected_later(found)
    for name, draft in drafts.items():
        free = [port for port in draft.ports.values() if f"{name}.{port.name}" not in used and not comes(name, port)]
        if free:
            listed = _listed([f"{port.name} ({_way(port)} {_kind(port)})" for port in free])
            word = "ports have" if len(free) > 1 else "port has"
            text = f"{len(free)} {word} no connection: {listed}"
            yield Said("note", "N-OPEN", ("components", name), text, of_key=True)


def _unwoken(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    """The findings about components that run on events and pull all their samples: nothing wakes them."""
    runs = contexts_of(found)
    feeds: dict[str, list[ConnectionEntry]] = {}
    for connection in found.system.connections:
        for reader in {path.partition(".")[0] for path in connection.ports[1:]}:
            feeds.setdefault(reader, []).append(connection)
    for name, fed in feeds.items():
        draft = drafts.get(name)
        if draft is None or not draft.complete or any(isinstance(port, ServicePort) for port in draft.ports.values()):
            continue
        waits = name in runs and all(isinstance(one, EventContext) and one.every is None for one in runs[name])
        profiles = [found.profiles.get(connection.number) for connection in fed]
        if waits and all(one is not None and one[0].dataflow is Dataflow.PULL for one in profiles):
            text = (
                f"{name} runs on events, and what it reads is pulled, which wakes no reader: only trigger() runs it; "
                "take dataflow away, give its context every = SECONDS, or put it into a periodic context"
            )
            yield Said("warning", "W-UNFED", ("connections", fed[0].number - 1, "dataflow"), text)


def _way(port: Port[Any]) -> str:
    return "service" if isinstance(port, ServicePort) else "out" if isinstance(port, OutPort) else "in"


def _kind(port: Port[Any]) -> str:
    return port.profile.type if isinstance(port, ServicePort) else type_name(port.type)


def _too_many(found: Survey) -> Iterator[Said]:
    counts: dict[type, int] = {}
    for name, cls in found.types.items():
        counts[cls] = counts.get(cls, 0) + 1
        if cls.max_instance is not None and counts[cls] == cls.max_instance + 1:
            text = f"{cls.__name__} allows {cls.max_instance} instances in a kernel, this is one more; take it away"
            yield Said("error", StateError.code, ("components", name, "type"), text)


def _left_alone(found: Survey) -> Iterator[Said]:
    does = {"continue": "goes on", "deactivate": "is deactivated", "error": "goes to error"}
    for name, cls in found.types.items():
        said = found.system.components[name].on_link_lost
        if (word := said or cls.on_link_lost) == cls.on_link_lost == "continue":
            continue
        key = ("components", name, "on_link_lost") if said else ("components", name)
        source = spelled(key) if said else f"{cls.__name__}.on_link_lost"
        text = f"{name} {does[word]} when the link to its operator is lost ({source})"
        yield Said("note", "N-OPERATOR", key, text, of_key=True)


def _mutable(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    told: set[type] = set()
    for name, draft in drafts.items():
        for port in draft.ports.values():
            if isinstance(port, OutPort) and port.type not in told and is_mutable(port.type):
                told.add(port.type)
                text = (
                    f"{name}.{port.name} sends {port.type.__name__}, which can be changed later on: each write "
                    "makes one snapshot; frozen records travel without one (@aiorts.types.record)"
                )
                yield Said("note", "N-COPY", ("components", name), text, of_key=True)


def _too_large(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    """The finding about ports whose samples a service that encodes them may refuse."""
    service = next(
        (name for name, plan in found.services.items() if plan.kind.encodes and name in found.system.services), None
    )
    if service is None:
        return
    outs = {
        f"{name}.{port.name}": port
        for name, draft in drafts.items()
        for port in draft.ports.values()
        if isinstance(port, OutPort)
    }
    if too_large := {path: said for path, port in outs.items() if (said := excess(port.type))}:
        listed = _listed([f"{path} ({said})" for path, said in too_large.items()])
        text = f"samples that are too large for it would be left out and counted: {listed}"
        yield Said("note", "N-LIMITS", (service,), text, of_key=True)


# -- writers that wait -------------------------------------------------------------------------------------------------


def _meetings(found: Survey) -> Iterator[Said]:
    """The findings about `length = 0` between parts that run together: a write would wait for a later read."""
    composites = found.system.composites
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is None or profile[0].length:
            continue
        writer, *readers = (path.partition(".")[0] for path in connection.ports)
        for reader in readers:
            outer = root(composites, writer)
            shared = [one.name for one in found.system.contexts.values() if {writer, reader}.issubset(one.members)]
            if reader == writer:
                where = f"both are ports of {writer}"
            elif shared:
                where = f"both run in {shared[0]}"
            elif outer in composites and root(composites, reader) == outer:
                where = f"both are members of {outer}"
            else:
                continue
            text = (
                "length = 0: the write would wait for a read that cannot begin before it is done: "
                f"{where}; run {reader} in another context, or set length = 1 or more"
            )
            yield Said("error", WiringError.code, ("connections", connection.number - 1), text)


def _standoffs(found: Survey) -> Iterator[Said]:
    """The findings about cycles with `length = 0` and no time-out: a component that waits in a write does not read."""
    edges: dict[str, dict[str, tuple[str, str, int]]] = {}
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is None or profile[0].length or profile[0].timeout is not None:
            continue
        out, *ins = connection.ports
        for in_ in ins:
            writer, reader = out.partition(".")[0], in_.partition(".")[0]
            if writer != reader:  # else `_meetings` refuses it
                edges.setdefault(writer, {}).setdefault(reader, (out, in_, connection.number))
                edges.setdefault(reader, {})
    for path, number, _ in cycles(edges):
        text = (
            f"{path}: length = 0 all the way round: when all of them write at the same time, each waits for the next "
            "one's read forever; set length = 1 or more at one of these connections, or a timeout"
        )
        yield Said("warning", "W-BLOCK", ("connections", number - 1, "length"), text)


def _waits(found: Survey) -> Iterator[Said]:
    """The findings about connectors with `full = "block"`, no time-out and too short a buffer inside one context.

    Members run one after the other. A writer takes all samples of its in-ports, and waits when it writes more samples
    than the buffer has room for; but the reader runs only afterwards. The count assumes one sample out for each
    sample in.
    """
    room: dict[str, int] = {}
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is not None:
            for reader in {path.partition(".")[0] for path in connection.ports[1:]}:
                room[reader] = room.get(reader, 0) + profile[0].length
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is None or profile[0].full is not FullPolicy.BLOCK or profile[0].timeout is not None:
            continue
        if not profile[0].length:
            continue  # `_meetings` refuses it where they run together
        writer = connection.ports[0].partition(".")[0]
        most = max(room.get(writer, 1), 1)
        if profile[0].length >= most or not (reader := _beside(found, connection, writer)):
            continue
        text = (
            f"{writer} may have {most} samples to pass on and there is room for {profile[0].length}: it would wait for "
            f"{reader}, which runs after it in the same context, forever; set length = {most} or more, or a timeout"
        )
        yield Said("warning", "W-BLOCK", ("connections", connection.number - 1, "full"), text)


def _outrun(found: Survey, drafts: Mapping[str, Draft]) -> Iterator[Said]:
    """The findings about readers that want every sample but are too slow: more come in a period than the buffer holds.

    The count assumes one sample for each cycle of the writer; a component without a rate (on events) is not judged.
    """
    for connection in found.system.connections:
        out, *ins = connection.ports
        writer = out.partition(".")[0]
        for path in ins:
            reader, _, name = path.partition(".")
            port = drafts[reader].ports.get(name) if reader in drafts else None
            length = getattr(port, "length", None)
            if length is None or connection.number not in found.profiles:
                continue
            profile, _ = connector_profile("", connection.options, "", connection.ports, length)
            written, looks = _rates(found, writer), _rates(found, reader)
            if not (written and looks) or not _keeps_all(profile):
                continue
            many = math.ceil(sum(written) / sum(looks))
            if many > profile.length:
                text = (
                    f"{writer} writes {sum(written):g} times in a second, {reader} reads {sum(looks):g} times: {many} "
                    f"samples come meanwhile and there is room for {profile.length}; set length = {2 * many} or more, "
                    f"enough where {reader} takes all in each cycle, or {SLOW_READER}"
                )
                key = ("connections", connection.number - 1)
                yield Said("warning", "W-DROPPED", key, text, of_key=True)


def _rates(found: Survey, component: str) -> list[float]:
    """The rates of a component's contexts; none when one of them has no rate."""
    contexts = [
        found.contexts.get(entry.name) for entry in found.system.contexts.values() if component in entry.members
    ]
    rates = [getattr(one, "rate", None) for one in contexts]
    return [rate for rate in rates if rate] if all(rates) else []


def _keeps_all(profile: ConnectorProfile) -> bool:
    """Whether every sample is put into the buffer, and none waits for room."""
    every = profile.subscription is Subscription.FLUSH or profile.push in (Push.ALL, Push.FIFO)
    return wakes(profile) and every and profile.full is not FullPolicy.BLOCK


def _beside(found: Survey, connection: ConnectionEntry, writer: str) -> str:
    """The first reader of a connection that runs only in contexts of the writer; "" if there is none."""
    for path in connection.ports[1:]:
        reader = path.partition(".")[0]
        theirs = [context for context in found.system.contexts.values() if reader in context.members]
        if theirs and all(writer in context.members for context in theirs):
            return reader
    return ""
