"""Connects service ports: all pairs of interfaces are decided here before anything is changed.

A required interface is bound to exactly one provided one, unless it is declared `many=True`; a provided one may answer
any number. Without a mapping, interfaces are paired by their type, and by the name of the instance where several fit.
"""

from __future__ import annotations

import inspect
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import DeclarationError, InterfaceMismatch, WiringError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.member import Visit
from aiorts.kernel.ports.port import Port, check_room, is_removed
from aiorts.model.interface import Method, check_of, differences, spelled
from aiorts.model.names import names_kernel
from aiorts.model.options import SERVICE_KEYS, is_yes
from aiorts.model.service_profile import ServiceConnectorProfile
from aiorts.services.activities import CallGraph
from aiorts.services.goal_keeper import GoalKeeper
from aiorts.services.service_arguments import goal_types, is_goal, look_of
from aiorts.services.service_ends import Provided, Required
from aiorts.services.service_port import ServiceConnector, ServiceEnd, ServicePort, is_service
from aiorts.services.service_proxy import make_proxy
from aiorts.services.tallies import GoalTally, Tally
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.services.service_call import ServiceCall

_NOBODY: Final = ("", "nil", "null", None)
"""The values in a mapping of an interface that is to stay unbound; the words are OpenRTM's."""


class Answer:
    """The way in which one method of an interface is answered."""

    __slots__ = ("_method", "check", "function", "goal", "look", "name", "plain", "visit")

    def __init__(self, method: Method, function: Any, visit: Visit) -> None:
        self._method = method
        self.name = method.name
        self.function = function
        self.plain = not inspect.iscoroutinefunction(function)
        self.goal = goal_types(method.returns)
        """The types of its goals; None where it does not answer with goals."""
        self.check = check_of(method.returns) if self.goal is None else is_goal
        self.look = look_of(method)
        self.visit = visit
        """The activity that holds the entry lock while the method runs at once."""

    @property
    def signature(self) -> inspect.Signature:
        """The signature for the caller."""
        return self._method.signature

    def takes(self, name: str) -> str:
        """The type of an argument, as it is written."""
        return spelled(self._method.signature.parameters[name].annotation)

    @property
    def hint(self) -> Any:
        """The type of the answer."""
        return self._method.returns

    @property
    def returns(self) -> str:
        """The type of the answer, as it is written."""
        return spelled(self._method.returns)


class Link:
    """One required interface bound to one provided one."""

    __slots__ = (
        "_proxy",
        "answers",
        "calls",
        "closed",
        "component",
        "connector",
        "entry_lock",
        "graph",
        "kernel",
        "now_ns",
        "provided",
        "required",
        "tally",
    )

    def __init__(self, required: Required[Any], provided: Provided[Any], connector: ServiceConnector) -> None:
        self.required = required
        self.provided = provided
        self.connector = connector
        self.component = provided.port._component
        self.entry_lock = cell(self.component).entry_lock
        self.kernel = provided._kernel
        self.graph = self.kernel.service(CallGraph)
        self.now_ns = self.kernel.clock.monotonic_ns
        self.closed = False
        self.tally = Tally()
        self.calls: dict[ServiceCall, None] = {}
        """The calls that wait or run."""
        path = provided.path.partition(".")[2]
        functions = provided._functions()
        self.answers = {
            name: Answer(method, functions[name], Visit(self.component, f"{path}.{name}"))
            for name, method in required.spec.methods.items()
        }
        self._proxy: Any = None
        if any(answer.goal is not None for answer in self.answers.values()):
            self.tally.goals = GoalTally()
            required._goals = provided._goals = self.kernel.service(GoalKeeper)

    @property
    def proxy(self) -> Any:
        """The proxy that calls this provider, and no other."""
        if self._proxy is None:
            self._proxy = make_proxy(self.required, self, self.required.timeout)
        return self._proxy

    @property
    def threaded(self) -> bool:
        """Whether calls are served in a thread of the provider's context."""
        host = cell(self.component)
        return (host.threaded or host.realtime) and not self.provided.concurrent

    def named(self, method: str) -> str:
        """The name of a call over this link, for messages."""
        return f"{self.required.path} -> {self.provided.path}.{method}"

    def end_calls(self, reason: str) -> None:
        """End the calls: their callers get an error, running methods are cancelled."""
        for call in tuple(self.calls):
            call.end(reason)


def plan(kernel: Microkernel, given: Sequence[Any], options: Mapping[str, Any]) -> list[tuple[str, Plan]]:
    """The connectors to make, fully checked: for each pair of ports the joined paths and the plan of its connector.

    Raises:
        WiringError: names the ports or options that do not go together, and why. InterfaceMismatch: names the method
            that does not fit.
    """
    where = " -> ".join(str(getattr(one, "path", repr(one))) for one in given)
    ends = _ends(kernel, where, given)
    mapping, strict = _options(where, options)
    plan = _Matching(where, ends, mapping, strict=strict, explicit=[e for e in given if isinstance(e, ServiceEnd)])
    pairs: dict[tuple[str, ...], list[tuple[Required[Any], Provided[Any]]]] = {}
    for required, provided in plan.pairs():
        pairs.setdefault(tuple(sorted((required.port.path, provided.port.path))), []).append((required, provided))
    _check_limits([port for those in pairs.values() for port in (those[0][0].port, those[0][1].port)])
    return [(f"{those[0][0].port.path}-{those[0][1].port.path}", Plan(those, strict)) for those in pairs.values()]


def end(connector: ServiceConnector) -> None:
    """Take a connector out of force: calls over it end."""
    connector._close()


def renewed(kernel: Microkernel, profile: ServiceConnectorProfile) -> Plan:
    """The plan that binds the pairs of a connector again; as far as possible, if the connector was not strict.

    Raises:
        WiringError: an interface is gone, is bound to another one, or does not fit any more.
    """
    pairs: list[tuple[Required[Any], Provided[Any]]] = []
    faults: list[WiringError] = []
    for pair in profile.mapping:
        try:
            pairs += plan(kernel, _ends_of(kernel, *pair), {"mapping": {pair[0]: pair[1]}})[0][1].pairs
        except WiringError as error:
            faults.append(error)
    if faults and (profile.strict or not pairs):
        raise faults[0]
    return Plan(pairs, profile.strict)


def _ends_of(kernel: Microkernel, required: str, provided: str) -> Sequence[Any]:
    """The interfaces of these paths, the provided one of this kernel or of another one."""
    far = kernel.connections.far
    if far is not None and names_kernel(provided):
        return far.resolve([_end_of(kernel, required), provided], {})[0]
    return [_end_of(kernel, required), _end_of(kernel, provided)]


def _end_of(kernel: Microkernel, path: str) -> ServiceEnd[Any]:
    """The interface of a path: `component.port`, or `component.port.interface`."""
    component, port, *_ = path.split(".")
    found = kernel.registry.find(f"{component}.{port}")
    for end in found.interfaces if isinstance(found, ServicePort) else ():
        if end.path == path:
            return end
    raise WiringError(f"{path}: there is no such interface")


def pairs_of(ports: Sequence[ServicePort], options: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The paths of each required interface of these ports and of the provided one that it would be bound with.

    Raises:
        WiringError: the ports cannot be connected.
    """
    where = " -> ".join(port.path for port in ports)
    mapping, strict = _options(where, options)
    ends = [end for port in ports for end in port.interfaces]
    found = _Matching(where, ends, mapping, strict=strict, explicit=[]).pairs()
    return [(required.path, provided.path) for required, provided in found]


def fault_of(ports: Sequence[ServicePort], options: Mapping[str, Any]) -> WiringError | None:
    """The error that keeps these ports, which need not be in a kernel yet, from being connected; else None."""
    try:
        pairs_of(ports, options)
    except WiringError as error:
        return error
    return None


class Plan:
    """A connector that is about to be made."""

    def __init__(self, pairs: list[tuple[Required[Any], Provided[Any]]], strict: bool) -> None:
        self.pairs = pairs
        self._strict = strict

    def make(self, name: str) -> ServiceConnector:
        """Make the connector, and put it in force."""
        ports = self.pairs[0][0].port, self.pairs[0][1].port
        mapping = tuple((required.path, provided.path) for required, provided in self.pairs)
        profile = ServiceConnectorProfile(name, tuple(port.path for port in ports), mapping, self._strict)
        connector = ServiceConnector(profile, ports)
        connector.links = tuple(Link(required, provided, connector) for required, provided in self.pairs)
        for link in connector.links:
            link.required._links += (link,)
            link.provided._links += (link,)
        for port in ports:
            port._services += (connector,)
            port._changed()
        return connector


def _ends(kernel: Microkernel, where: str, given: Sequence[Any]) -> list[ServiceEnd[Any]]:
    ends: dict[ServiceEnd[Any], None] = {}
    for one in given:
        if isinstance(one, ServiceEnd) and one._port is None:
            raise WiringError(f"{one!r}: is a declaration; connect what belongs to a component that was added")
        if not is_service(one):
            what = "a data port" if isinstance(one, Port) else "no port"
            raise WiringError(f"{where}: {getattr(one, 'path', repr(one))} is {what}, the others are service ports")
        port: ServicePort = one.port if isinstance(one, ServiceEnd) else one
        if cell(port._component).kernel is not kernel:
            raise WiringError(f"{port.path}: belongs to another kernel, or to none yet; await kernel.add(...) first")
        if is_removed(port):
            raise WiringError(f"{port.path}: this port or its component was removed")
        ends.update(dict.fromkeys(port.interfaces if one is port else (one,)))
    return list(ends)


def _options(where: str, options: Mapping[str, Any]) -> tuple[dict[str, Any], bool]:
    plain = {key.removeprefix("port.connection."): value for key, value in options.items()}
    mapping = dict(plain.pop("mapping", None) or {})
    strictness = plain.pop("strictness", None)
    if isinstance(strictness, str):
        strictness = strictness.strip().lower()
    strict = plain.pop("strict", None)
    plain.pop("name", None)
    for key in tuple(plain):
        if key.startswith("mapping."):  # a table of a system file, which is laid out flat
            mapping[key.removeprefix("mapping.")] = plain.pop(key)
        elif ".required." in key:  # OpenRTM's way to say it
            mapping[key] = plain.pop(key)
    for key in plain:
        known = (*SERVICE_KEYS, "name")
        hint = suggestion(key, known, f"service ports have {', '.join(known)}")
        raise WiringError(f"{where}: unknown option {key!r}; {hint}")
    if strict is not None:
        return mapping, is_yes(where, "strict", strict)
    if strictness not in (None, "strict", "best_effort"):
        raise WiringError(f"{where}: strictness = {strictness!r}: expected strict or best_effort")
    return mapping, strictness != "best_effort"


class _Matching:
    """Finds the provided interfaces that answer each required one."""

    def __init__(
        self,
        where: str,
        ends: list[ServiceEnd[Any]],
        mapping: Mapping[str, Any],
        *,
        strict: bool,
        explicit: list[ServiceEnd[Any]],
    ) -> None:
        self._where = where
        self._strict = strict
        self._required = [end for end in ends if isinstance(end, Required)]
        self._provided = [end for end in ends if isinstance(end, Provided)]
        self._explicit = explicit
        if not self._required or not self._provided:
            kind = "requires" if self._provided else "provides"
            what = ", ".join(f"{end.path} {end.polarity} {end.spec.name}" for end in ends) or "nothing"
            raise WiringError(f"{where}: no port {kind} anything ({what}); connect a Required with a Provided")
        self._mapped: dict[Required[Any], Provided[Any] | None] = {}
        for key, value in mapping.items():
            required = self._named(key, self._required)
            self._mapped[required] = None if value in _NOBODY else self._named(value, self._provided)

    def pairs(self) -> list[tuple[Required[Any], Provided[Any]]]:
        """The pairs of required and provided interfaces to bind; WiringError when one that must be bound cannot be."""
        found = [(required, provided) for required in self._required for provided in self._for(required)]
        if not found:
            fitting = [one for one in self._provided if any(self._may(required, one) for required in self._required)]
            raise self._bound_already(fitting) or WiringError(
                f"{self._where}: nothing would be bound; there is no provider that fits"
            )
        return found

    def _for(self, required: Required[Any]) -> list[Provided[Any]]:
        mapped = self._mapped.get(required)
        if required in self._mapped and mapped is None:
            return []
        meant = mapped is not None or required in self._explicit or len(self._required) == 1
        if required._links and not required.many:
            if meant:
                raise _taken(required)
            return []
        bound = [link.provided for link in required._links]
        others = [mapped] if mapped is not None else [p for p in self._provided if p.port is not required.port]
        fitting = [provided for provided in others if not self._wrong(required, provided)]
        free = [provided for provided in fitting if provided not in bound]
        if fitting and not free:
            if meant:
                raise WiringError(f"{required.path} -> {fitting[0].path}: connected already")
            return []
        if not free:
            if mapped is not None:
                raise self._mismatch(required, others)
            if self._strict:
                raise self._bound_already(others) or self._mismatch(required, others)
            return []
        return free if required.many else [self._one(required, free)]

    def _one(self, required: Required[Any], fitting: list[Provided[Any]]) -> Provided[Any]:
        if len(fitting) == 1:
            return fitting[0]
        same = [provided for provided in fitting if provided.instance == required.instance]
        if len(same) == 1:
            return same[0]
        raise WiringError(
            f"{required.path}: {', '.join(provided.path for provided in fitting)} all provide {required.spec.name}; "
            f"say which: mapping={{{required.path!r}: {fitting[0].path!r}}}"
        )

    def _bound_already(self, provided: Sequence[Provided[Any]]) -> WiringError | None:
        """The error if each of these providers fits an interface that is bound already; else None."""
        bound = [required for required in self._required if required._links and not required.many]
        takers = [next((one for one in bound if self._may(one, answering)), None) for answering in provided]
        return _taken(takers[0]) if takers and takers[0] is not None and None not in takers else None

    def _may(self, required: Required[Any], provided: Provided[Any]) -> bool:
        return provided.port is not required.port and not self._wrong(required, provided)

    def _wrong(self, required: Required[Any], provided: Provided[Any]) -> list[str]:
        if provided.interface is required.interface:
            return self._unanswered(provided)
        return differences(required.spec.methods, provided.spec.methods) or self._unanswered(provided)

    @staticmethod
    def _unanswered(provided: Provided[Any]) -> list[str]:
        try:
            provided._functions()
        except DeclarationError as error:
            return [str(error)]
        return []

    def _mismatch(self, required: Required[Any], others: list[Provided[Any]]) -> WiringError:
        if not others:
            return WiringError(f"{required.path}: none of the other ports provides anything; connect one that does")
        why = "; ".join(
            f"{provided.path} provides {provided.spec.name}: {'; '.join(self._wrong(required, provided))}"
            for provided in others
        )
        return InterfaceMismatch(f"{self._where}: {required.path} requires {required.spec.name}, {why}")

    def _named(self, key: Any, ends: Sequence[Any]) -> Any:
        """The interface of a path, of an instance's name, or of OpenRTM's long name."""
        text = getattr(key, "path", str(key))
        named = [end for end in ends if text in (end.path, _long_name(end))]
        named = named or [end for end in ends if text == end.instance]
        if len(named) == 1:
            return named[0]
        among = ", ".join(end.path for end in named or ends)
        raise WiringError(
            f"{self._where}: mapping: {text!r}: {'several are' if named else 'none is'} called so: {among}"
        )


def _taken(required: Required[Any]) -> WiringError:
    link = required._links[0]
    return WiringError(
        f"{required.path}: is bound to {link.provided.path} already; disconnect {link.connector.name} first, "
        "or declare it many=True"
    )


def _long_name(end: ServiceEnd[Any]) -> str:
    component, _, _ = end.path.partition(".")
    return f"{component}.port.{end.port.name}.{end.polarity}.{end.spec.name}.{end.instance}"


def _check_limits(ports: list[ServicePort]) -> None:
    for port, more in Counter(ports).items():
        check_room(port, more, port.max_connectors)
