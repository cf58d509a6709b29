"""Finds circles of components that run on events: circles that are busy forever, or wait for themselves. Pure.

A circle has one finding: it never rests once a sample is in it (W-LOOP), or stands still because no component writes
the first sample (N-CIRCLE).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Any, Final

from aiorts.contexts import EventContext
from aiorts.kernel.component import Component
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.hooks import HookKind
from aiorts.kernel.ports import InPort, Port
from aiorts.model.policy import Dataflow
from aiorts.model.wanted.entries import ConnectionEntry
from aiorts.services import ServicePort
from aiorts.system.checks.cycles import Edges, cycles
from aiorts.system.checks.draft import Draft
from aiorts.system.checks.findings import Said
from aiorts.system.checks.hook_code import may_write, names_of
from aiorts.system.checks.surveyed import connected_later, contexts_of, is_service, names_no_port, wakes
from aiorts.system.file.families import activation_order, root
from aiorts.system.file.survey import Survey

_ON_ACTIVATED: Final = "on_activated"
_ON_EXECUTE: Final = "on_execute"
_SLEEPS: Final = frozenset({"sleep", "sleep_until"})
_BY_THEMSELVES: Final = ("on_initialize", "on_startup", _ON_ACTIVATED)
"""Hooks that run without a sample, and so may write a circle's first sample."""
BEGIN: Final = (
    "write the first one in on_activated, to a connection with keep_last = true, or put one of them into a periodic "
    "context"
)
"""The advice for a circle in which no component writes the first sample."""


def circle_findings(found: Survey, drafts: Mapping[str, Draft], *, whole: bool) -> Iterator[Said]:
    """One finding for each circle; `whole` is False when parts were left out, which may start a circle."""
    waiting = _Beginning(found, drafts).waiting() if whole else _Waiting({}, {})
    for path, number, members in cycles(waiting.edges):
        doubts = _doubts(waiting.doubts(members))
        early = [waiting.early[name] for name in members if name in waiting.early]
        why = f"and {early[0]}" if early else f"and none begins{doubts}"
        text = f"{path}: each waits for a sample of the one before, {why}; {BEGIN}"
        yield Said("note", "N-CIRCLE", ("connections", number - 1), text, of_key=True)
    yield from _loops(found, drafts, waiting.edges)


def _doubts(hooks: Iterable[tuple[str, str]]) -> str:
    """The clause about components that may write a circle's first sample after all, grouped by hook."""
    names: dict[str, list[str]] = {}
    for name, hook in hooks:
        names.setdefault(hook, []).append(name)
    said = " or ".join(f"{hook} of {' or '.join(those)}" for hook, those in names.items())
    return f", unless {said} writes first" if said else ""


def _loops(found: Survey, drafts: Mapping[str, Draft], without: Collection[str]) -> Iterator[Said]:
    """The findings about cycles that one sample keeps busy forever: all members run in event contexts only.

    Such a cycle has no pulled connector, which wakes no reader; no periodic one, which is paced; no connection of a
    port that does not exist; and no component that sleeps in on_execute, which paces the cycle.
    """
    eager = {name for name, those in contexts_of(found).items() if all(isinstance(one, EventContext) for one in those)}
    eager -= {name for name, one in drafts.items() if _sleeps_itself(one.component)}
    edges: dict[str, dict[str, tuple[str, str, int]]] = {name: {} for name in found.system.components if name in eager}
    for connection in found.system.connections:
        profile = found.profiles.get(connection.number)
        if profile is None or not wakes(profile[0]):
            continue
        out, *ins = connection.ports
        if is_service(drafts, out):
            continue  # a call waits for its answer, and wakes no reader
        for in_ in ins:
            writer, reader = out.partition(".")[0], in_.partition(".")[0]
            if writer in edges and reader in edges and writer not in without and not names_no_port(drafts, (out, in_)):
                edges[writer].setdefault(reader, (out, in_, connection.number))
    for path, number, _ in cycles(edges):
        text = (
            f"{path}: all run on events, so that one sample keeps this cycle busy forever; "
            f"put one of them into a periodic context, or await a sleep in its on_execute"
        )
        yield Said("warning", "W-LOOP", ("connections", number - 1), text, of_key=True)


def _sleeps_itself(component: Component | None) -> bool:
    """Whether the component's on_execute awaits a sleep, which paces its circle."""
    if component is None or cell(component).hook_kinds[_ON_EXECUTE] != HookKind.ASYNC:
        return False
    return not _SLEEPS.isdisjoint(names_of(type(component), _ON_EXECUTE))


class _Waiting:
    """Components that wait for a sample from one another, and get none from outside."""

    def __init__(self, edges: Edges, early: Mapping[str, str], hooks: Mapping[str, str] | None = None) -> None:
        self.edges = edges
        self.early = early
        """An explanation of how a component's first sample is lost, by the name of the component."""
        self._hooks = hooks or {}

    def doubts(self, members: Collection[str]) -> Iterator[tuple[str, str]]:
        """The members that have a hook which runs by itself but seems to write nothing; each with that hook."""
        return ((name, self._hooks[name]) for name in members if name in self._hooks)


class _Beginning:
    """Finds the components that neither begin by themselves nor get a sample from outside."""

    def __init__(self, found: Survey, drafts: Mapping[str, Draft]) -> None:
        self._found, self._drafts = found, drafts
        self._contexts = contexts_of(found)
        self._order = {name: place for place, name in enumerate(activation_order(found.system))}
        """The place of each component in the order of activation; members have that of their composite."""
        self._early: dict[str, str] = {}

    def waiting(self) -> _Waiting:
        """Find the components that wait."""
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
        """Whether a component runs only when a sample comes, apart from hooks that run once."""
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
        """Whether a component has the hook, and the hook's code uses a name: `pass` or a docstring uses none."""
        component = self._drafts[name].component
        return component is not None and self._has(name, hook) and bool(names_of(type(component), hook))

    def _begins(self, writer: str, reader: str, out: str, connection: ConnectionEntry) -> bool:
        """Whether a hook of the writer that runs by itself may write to this port a sample that the reader gets."""
        component, port = self._drafts[writer].component, out.partition(".")[2]
        for hook in _BY_THEMSELVES:
            if component is None or not self._has(writer, hook) or not may_write(component, hook, port):
                continue
            if hook != _ON_ACTIVATED or not self._is_early(writer, reader, connection):
                return True
            self._early[writer] = f"what {hook} of {writer} writes is lost, because {reader} is activated later"
        return False

    def _is_early(self, writer: str, reader: str, connection: ConnectionEntry) -> bool:
        """Whether the reader is surely activated after the writer, over a connector that keeps no sample for later."""
        system, profile = self._found.system, self._found.profiles.get(connection.number)
        ends = [root(system.composites, name) for name in (writer, reader)]
        if profile is None or profile[0].keep_last or any(system.components[name].start for name in (writer, reader)):
            return False
        return self._order[ends[0]] < self._order[ends[1]]


def _is_fed(name: str, port: Port[Any], comes: Callable[[str, Port[Any]], bool]) -> bool:
    return isinstance(port, InPort) and comes(name, port)
