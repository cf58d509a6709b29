"""Circles of components that run on events: who keeps itself busy forever, and who waits for itself. Pure.

A circle has one finding: with a sample in it, it never rests (W-LOOP); where none begins, it stands still (N-CIRCLE).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from types import CodeType, FunctionType
from typing import Any, Final

from aiorts.contexts import EventContext
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.model.policy import Dataflow, Subscription
from aiorts.model.profile import ConnectorProfile
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.rules import RulesSettings, ruled
from aiorts.services import ServicePort
from aiorts.system.checks.draft import Draft
from aiorts.system.checks.findings import Said
from aiorts.system.file.families import activation_order, root
from aiorts.system.file.survey import Survey

_MOST_NAMED: Final = 12
"""Ports of a cycle that a message names."""
_ON_ACTIVATED: Final = "on_activated"
_ON_EXECUTE: Final = "on_execute"
_SLEEPS: Final = frozenset({"sleep", "sleep_until"})
_BY_THEMSELVES: Final = ("on_initialize", "on_startup", _ON_ACTIVATED)
"""Hooks that run though no sample came, and may write the first one."""
BEGIN: Final = (
    "write the first one in on_activated, to a connection with keep_last = true, or put one of them into a periodic "
    "context"
)
"""What starts a circle."""
Edges = Mapping[str, Mapping[str, tuple[str, str, int]]]
"""From component to component: the ports between them, and the number of the connection."""


def circle_findings(found: Survey, drafts: Mapping[str, Draft], *, whole: bool) -> Iterator[Said]:
    """One finding for each circle; `whole` is False when parts were left out, which may begin one."""
    waiting = _Beginning(found, drafts).waiting() if whole else _Waiting({}, {})
    for path, number, members in cycles(waiting.edges):
        doubts = _doubts(waiting.doubts(members))
        early = [waiting.early[name] for name in members if name in waiting.early]
        why = f"and {early[0]}" if early else f"and none begins{doubts}"
        text = f"{path}: each waits for a sample of the one before, {why}; {BEGIN}"
        yield Said("note", "N-CIRCLE", ("connections", number - 1), text, of_key=True)
    yield from _loops(found, drafts, waiting.edges)


def _doubts(hooks: Iterable[tuple[str, str]]) -> str:
    """Who may begin a circle all the same: names that have the same hook are said together."""
    names: dict[str, list[str]] = {}
    for name, hook in hooks:
        names.setdefault(hook, []).append(name)
    said = " or ".join(f"{hook} of {' or '.join(those)}" for hook, those in names.items())
    return f", unless {said} writes first" if said else ""


def _loops(found: Survey, drafts: Mapping[str, Draft], without: Collection[str]) -> Iterator[Said]:
    """Cycles whose members are all in event contexts alone: with one sample in it, such a cycle never rests.

    A connector that the reader pulls wakes nobody, and one of a period is paced: neither is part of such a cycle. Nor
    is a connection of a port that is not there; and a member that sleeps paces its cycle.
    """
    eager = {name for name, those in contexts_of(found).items() if all(isinstance(one, EventContext) for one in those)}
    eager -= {name for name, one in drafts.items() if _sleeps_itself(one.component)}
    edges: dict[str, dict[str, tuple[str, str, int]]] = {name: {} for name in found.system.components if name in eager}
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is None or not wakes(profile[0]):
            continue
        out, *ins = connection.ports
        if _is_service(drafts, out):
            continue  # a call waits for its answer, and wakes nobody
        for in_ in ins:
            writer, reader = out.partition(".")[0], in_.partition(".")[0]
            if writer in edges and reader in edges and writer not in without and not _missing(drafts, (out, in_)):
                edges[writer].setdefault(reader, (out, in_, connection.number))
    for path, number, _ in cycles(edges):
        text = (
            f"{path}: all run on events, so that one sample keeps this cycle busy forever; "
            f"put one of them into a periodic context, or await a sleep in its on_execute"
        )
        yield Said("warning", "W-LOOP", ("connections", number - 1), text, of_key=True)


def _sleeps_itself(component: Component | None) -> bool:
    """Whether its on_execute awaits a sleep, which paces the circle that it is in."""
    if component is None or cell(component).hook_kinds[_ON_EXECUTE] != HookKind.ASYNC:
        return False
    return not _SLEEPS.isdisjoint(_names_of(type(component), _ON_EXECUTE))


class _Waiting:
    """Components that wait for a sample of one another, and none is sent to them."""

    def __init__(self, edges: Edges, early: Mapping[str, str], hooks: Mapping[str, str] | None = None) -> None:
        self.edges = edges
        self.early = early
        """Of one whose first sample is lost: how."""
        self._hooks = hooks or {}

    def doubts(self, members: Collection[str]) -> Iterator[tuple[str, str]]:
        """Members with a hook that runs by itself and seems to write nothing."""
        return ((name, self._hooks[name]) for name in members if name in self._hooks)


class _Beginning:
    """Finds who is not begun by anything: neither by itself nor by a sample from outside."""

    def __init__(self, found: Survey, drafts: Mapping[str, Draft]) -> None:
        self._found, self._drafts = found, drafts
        self._contexts = contexts_of(found)
        self._order = {name: place for place, name in enumerate(activation_order(found.system))}
        """When each is activated, a composite with its members."""
        self._early: dict[str, str] = {}

    def waiting(self) -> _Waiting:
        """Who waits."""
        system, drafts = self._found.system, self._drafts
        comes = connected_later(self._found)
        asleep = [name for name in system.components if name in drafts and self._sleeps(name, drafts[name], comes)]
        edges: dict[str, dict[str, tuple[str, str, int]]] = {name: {} for name in asleep}
        woken = list[str]()
        for connection in system.connections:
            if not self._is_pushed(connection):
                continue  # a pull wakes no reader
            out, *ins = connection.ports
            writer = out.partition(".")[0]
            for in_ in ins:
                reader = in_.partition(".")[0]
                if writer in edges:
                    edges[writer].setdefault(reader, (out, in_, connection.number))
                runs = writer not in edges and (writer in self._contexts or writer not in system.components)
                if runs or (writer in edges and self._begins(writer, reader, out, connection)):
                    woken.append(reader)
        while woken:
            woken += edges.pop(woken.pop(), {})
        left = {name: {to: way for to, way in those.items() if to in edges} for name, those in edges.items()}
        hooks = {name: hook for name in left for hook in _BY_THEMSELVES if self._does(name, hook)}
        return _Waiting(left, self._early, hooks)

    def _sleeps(self, name: str, one: Draft, comes: Callable[[str, Port[Any]], bool]) -> bool:
        """Whether it runs only because a sample came, or in a hook that runs once."""
        fed = any(isinstance(port, ServicePort) or _is_fed(name, port, comes) for port in one.ports.values())
        contexts = self._contexts.get(name, [])
        sleeps = all(isinstance(context, EventContext) and context.every is None for context in contexts)
        return one.component is not None and one.complete and not fed and bool(contexts) and sleeps

    def _is_pushed(self, connection: ConnectionEntry) -> bool:
        profile = self._found.profiles.get(connection.number)
        return profile is None or profile[0].dataflow is Dataflow.PUSH

    def _has(self, name: str, hook: str) -> bool:
        component = self._drafts[name].component
        return component is not None and cell(component).hook_kinds[hook] != HookKind.ABSENT

    def _does(self, name: str, hook: str) -> bool:
        """Whether it has the hook, and that does anything: one of `pass` or a docstring alone uses no name."""
        component = self._drafts[name].component
        return component is not None and self._has(name, hook) and bool(_names_of(type(component), hook))

    def _begins(self, writer: str, reader: str, out: str, connection: ConnectionEntry) -> bool:
        """Whether a hook of the writer that runs by itself may write there, and the reader gets it."""
        component, port = self._drafts[writer].component, out.partition(".")[2]
        for hook in _BY_THEMSELVES:
            if component is None or not self._has(writer, hook) or not _may_write(component, hook, port):
                continue
            if hook != _ON_ACTIVATED or not self._is_early(writer, reader, connection):
                return True
            self._early[writer] = f"what {hook} of {writer} writes is lost, because {reader} is activated later"
        return False

    def _is_early(self, writer: str, reader: str, connection: ConnectionEntry) -> bool:
        """Whether the reader is surely not active when the writer is activated, and is given no sample later."""
        system, profile = self._found.system, self._found.profiles.get(connection.number)
        ends = [root(system.composites, name) for name in (writer, reader)]
        if profile is None or profile[0].keep_last or any(system.components[name].start for name in (writer, reader)):
            return False
        return self._order[ends[0]] < self._order[ends[1]]


def _is_fed(name: str, port: Port[Any], comes: Callable[[str, Port[Any]], bool]) -> bool:
    return isinstance(port, InPort) and comes(name, port)


def _may_write(component: Component, hook: str, port: str) -> bool:
    """Whether a hook, or what it calls of its class and file, names an out-port; where that is not seen, it may."""
    declared = declarations(type(component)).ports
    names = {attribute for attribute, one in declared.items() if port in (attribute, one.name)}
    return not names or not names.isdisjoint(used := _names_of(type(component), hook)) or "ports" in used


def _names_of(cls: type[Any], hook: str) -> set[str]:
    """The names in the code of a method, and in that of the functions of its class and file that it names."""
    used: set[str] = set()
    left = _functions(cls, hook)
    seen: set[CodeType] = set()
    while left:
        function = left.pop()
        codes = [function.__code__]
        while codes:
            code = codes.pop()
            if code in seen:
                continue
            seen.add(code)
            codes += [one for one in code.co_consts if isinstance(one, CodeType)]
            for name in code.co_names:
                used.add(name)
                left += _functions(cls, name)
                if isinstance(helper := function.__globals__.get(name), FunctionType):
                    left.append(helper)
    return used


def _functions(cls: type[Any], name: str) -> list[FunctionType]:
    """What the classes of the user have under this name, as far as it is functions."""
    owners = [one for one in cls.__mro__ if one not in Component.__mro__]
    return [found for one in owners if isinstance(found := vars(one).get(name), FunctionType)]


# -- of the survey -----------------------------------------------------------------------------------------------------


def connected_later(found: Survey) -> Callable[[str, Port[Any]], bool]:
    """Whether a port is one that `[[rules]]` connect when the system runs."""
    settings = found.services["rules"].settings if "rules" in found.services else None
    if not isinstance(settings, RulesSettings):
        return lambda _name, _port: False
    fits = ruled(settings.rules)
    return lambda name, port: isinstance(port, InPort | OutPort) and fits(name, port.name, isinstance(port, OutPort))


def contexts_of(found: Survey) -> dict[str, list[Any]]:
    """The contexts in which each component is."""
    contexts: dict[str, list[Any]] = {}
    for entry in found.system.contexts.values():
        for member in entry.members:
            contexts.setdefault(member, []).append(found.contexts.get(entry.name))
    return contexts


def _missing(drafts: Mapping[str, Draft], paths: Iterable[str]) -> bool:
    """Whether a component whose ports are known has none of this name."""
    for path in paths:
        component, _, port = path.partition(".")
        if component in drafts and drafts[component].complete and port not in drafts[component].ports:
            return True
    return False


def _is_service(drafts: Mapping[str, Draft], path: str) -> bool:
    component, _, port = path.partition(".")
    return component in drafts and isinstance(drafts[component].ports.get(port), ServicePort)


def wakes(profile: ConnectorProfile) -> bool:
    return profile.dataflow is Dataflow.PUSH and profile.subscription is not Subscription.PERIODIC


def cycles(edges: Edges) -> Iterator[tuple[str, int, list[str]]]:
    """Ways from components back to themselves, each component in one: the ports, the number of the last step, who."""
    told: set[str] = set()
    for start in edges:
        if start in told or not (cycle := _cycle(edges, start)):
            continue
        told.update(cycle)
        path = [
            port for here, there in zip(cycle, [*cycle[1:], cycle[0]], strict=True) for port in edges[here][there][:2]
        ]
        shown = [*path[:_MOST_NAMED], "..."] if len(path) > _MOST_NAMED else path
        yield " → ".join([*shown, path[0]]), edges[cycle[-1]][cycle[0]][2], cycle


def _cycle(edges: Mapping[str, Mapping[str, Any]], start: str) -> list[str]:
    """The shortest way from a component back to itself; empty where there is none."""
    came: dict[str, str] = {}
    level = [start]
    while level:
        following = []
        for here in level:
            for there in edges[here]:
                if there == start:
                    way = [here]
                    while way[-1] != start:
                        way.append(came[way[-1]])
                    return way[::-1]
                if there not in came:
                    came[there] = here
                    following.append(there)
        level = following
    return []
