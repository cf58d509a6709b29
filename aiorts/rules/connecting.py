"""The service that connects ports by rules: ports that come or go are noted, and looked at in the loop's next turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError
from aiorts.kernel.loop.bus import Disconnected, PortAdded, PortRemoved
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.port import is_removed
from aiorts.kernel.service import KernelService, setting
from aiorts.late import dataclass
from aiorts.rules.rule import LARGEST_MAX, USUAL_MAX, Rule, pattern_of, rules_of

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

Pair = tuple[str, str]
_LOG: Final = KernelLog()
_REMEMBERED: Final = 1000
"""Pairs with removed ports that are remembered as a rule's, for components that are restarted."""
_PATTERN: Final = {"type": "string", "minLength": 3, "pattern": r"^[^.]+\.[^.]+$"}
_ENTRY: Final = {
    "type": "object",
    "required": ["from", "to"],
    "properties": {
        "from": {**_PATTERN, "description": 'The out-ports: COMPONENT.PORT with *, ? or [abc], such as "*.pose".'},
        "to": {**_PATTERN, "description": 'The in-ports, such as "logger.*"; those of the same type are connected.'},
        "max": {
            "type": "integer",
            "minimum": 1,
            "maximum": LARGEST_MAX,
            "default": USUAL_MAX,
            "description": "Connectors that the rule makes at the most.",
        },
    },
}


@dataclass(frozen=True, slots=True)
class RulesSettings:
    """Ports that are connected by patterns of their paths, as they come."""

    rules: tuple[Mapping[str, Any], ...] = setting(
        (), "[[rules]]: a rule; beside from, to and max it has options of its connectors.", schema={"items": _ENTRY}
    )

    def __post_init__(self) -> None:
        rules_of(self.rules)


class _Live:
    """A rule, the ports that fit it by component, and the connectors that it has made."""

    __slots__ = ("beyond", "ins", "made", "outs", "place", "rule", "source", "target")

    def __init__(self, place: str, rule: Rule) -> None:
        self.place, self.rule = place, rule
        self.source, self.target = pattern_of(rule.source), pattern_of(rule.target)
        self.outs: dict[str, list[OutPort[Any]]] = {}
        self.ins: dict[str, list[InPort[Any]]] = {}
        self.made: dict[Pair, Connector] = {}
        """The connectors by the paths of their ports, while both are there: one that was ended is not made again."""
        self.beyond = False
        """Whether more ports fit than `max` lets it connect."""

    @property
    def count(self) -> int:
        return sum(not one.closed for one in self.made.values())

    def note(self, name: str, component: Component | None) -> None:
        """Note the ports of a component that fit the rule; None: the component is gone."""
        self.outs.pop(name, None)
        self.ins.pop(name, None)
        if component is None:
            return
        for word, port in component.ports.items():
            if isinstance(port, OutPort) and self.source.fits(name, word):
                self.outs.setdefault(name, []).append(port)
            elif isinstance(port, InPort) and self.target.fits(name, word):
                self.ins.setdefault(name, []).append(port)

    def pairs(self, changed: Mapping[str, None] | None) -> Iterator[tuple[OutPort[Any], InPort[Any]]]:
        """The pairs that fit, of these components or of all, in the order in which the components came."""
        for writer, outs in tuple(self.outs.items()):
            readers = self.ins if changed is None or writer in changed else self.ins.keys() & changed.keys()
            for reader in [one for one in self.ins if one in readers] if readers else ():
                for out in outs:
                    for in_ in self.ins[reader]:
                        if issubclass(out.type, in_.type) and _owner(out) != _owner(in_):
                            yield out, in_


def _live(rules: Sequence[Mapping[str, Any]]) -> tuple[_Live, ...]:
    found = enumerate(rules_of(rules), 1)
    return tuple(_Live(f"rules[{number}] ({one.source} to {one.target})", one) for number, one in found)


class ConnectingRules(KernelService):
    """The rules of one kernel; those of a system file begin once the system was made."""

    name = "rules"
    settings = RulesSettings

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self._rules: tuple[_Live, ...] = ()
        self._changed: dict[str, None] = {}
        """Components that have come, gone or changed since the last look."""
        self._held = 0
        self._waits = self._hears = False
        self._gone: dict[Pair, str] = {}
        """The names of connectors that a rule made, whose ports are gone."""
        self._told: set[Pair] = set()

    def configure(self, settings: RulesSettings) -> None:
        self._rules = _live(settings.rules)
        self._follow_bus()

    def _follow_bus(self) -> None:
        """Follow ports that come and go from now on, and look at present ones."""
        for name in self.kernel.components:
            self._note(name)
        if self._hears:
            return
        self._hears = True
        bus = self.kernel.bus
        bus.subscribe(PortAdded, lambda event: self._note(event.component))
        bus.subscribe(PortRemoved, lambda event: self._note(event.component))
        bus.subscribe(Disconnected, lambda _event: self._soon())

    def change(self, rules: Sequence[Mapping[str, Any]]) -> None:
        """Add rules at the end, or end the last ones with their connectors: one of the two lists begins with the other.

        Raises:
            ConfigurationError: an entry is no rule; nothing was changed.
        """
        stay = min(len(rules), len(self._rules))
        gone, kept = self._rules[stay:], self._rules[:stay]
        self._rules = (*kept, *_live(rules)[stay:])
        self._follow_bus()
        self.table = {"rules": list(rules)} if rules else None
        for rule in gone:
            for connector in tuple(rule.made.values()):
                connector.close()

    def component_added(self, component: Component) -> None:
        self._note(component.name)

    def component_removed(self, component: Component) -> None:
        self._note(component.name)

    def components_replaced(self, pairs: Mapping[Component, Component]) -> None:
        for component in pairs.values():
            self._note(component.name)

    def report(self) -> Mapping[str, Any]:
        return {one.place: {"connectors": one.count, "max": one.rule.most} for one in self._rules}

    def owns(self, connector: Connector) -> bool:
        pair = connector.out.path, connector.in_.path
        for one in self._rules:
            made = one.made.get(pair)
            if made is connector:
                return True
            if made is not None and made.name == connector.name and (is_removed(made.out) or is_removed(made.in_)):
                return True  # a component was restarted, and the next look takes it over
        return self._gone.get(pair) == connector.name

    @contextmanager
    def making(self) -> Iterator[None]:
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
            self._soon()

    def _note(self, component: str) -> None:
        self._changed[component] = None
        self._soon()

    def _soon(self) -> None:
        if not self._waits and not self.kernel.closed:
            self._waits = True
            self.kernel.loop.call_soon(self._look)

    def _look(self) -> None:
        self._waits = False
        if self._held or self.kernel.closed:
            return
        changed, self._changed = self._changed, {}
        kernel = self.kernel
        for name in changed:
            component = kernel.components.get(name)
            if component is not None and (
                kernel.registry.is_arriving(component) or kernel.registry.is_leaving(component)
            ):
                component = None
            for rule in self._rules:
                rule.note(name, component)
        for rule in self._rules:
            self._forget_gone(rule)
        for rule in self._rules:
            self._follow(rule, None if rule.beyond else changed)

    def _forget_gone(self, rule: _Live) -> None:
        for pair, connector in tuple(rule.made.items()):
            if connector.closed and (is_removed(connector.out) or is_removed(connector.in_)):
                del rule.made[pair]
                self._gone[pair] = connector.name
                if len(self._gone) > _REMEMBERED:
                    del self._gone[next(iter(self._gone))]

    def _follow(self, rule: _Live, changed: Mapping[str, None] | None) -> None:
        if changed is not None and not changed:
            return
        count, beyond = rule.count, False
        for out, in_ in rule.pairs(changed):
            pair = out.path, in_.path
            if any(pair in one.made for one in self._rules):
                continue
            there = _between(out, in_)
            if there is not None:
                if self._gone.get(pair) == there.name:  # a component that was restarted has it back
                    del self._gone[pair]
                    rule.made[pair] = there
                    count += 1
            elif count >= rule.rule.most:
                beyond = True
                break
            else:
                count += self._connect(rule, out, in_, pair)
        if beyond and not rule.beyond:
            what = f"has its {rule.rule.most} connectors, and more ports fit; raise max"
            _LOG.warning("W-RULES: %s: %s", rule.place, what)
        rule.beyond = beyond if changed is None or beyond else rule.beyond

    def _connect(self, rule: _Live, out: OutPort[Any], in_: InPort[Any], pair: Pair) -> bool:
        try:
            (connector,) = self.kernel.connections.make((out, in_), rule.rule.options)
        except AiortsError as error:
            if pair not in self._told:
                self._told.add(pair)
                _LOG.warning("W-RULES: %s: %s", rule.place, error)
            return False
        self._gone.pop(pair, None)
        rule.made[pair] = connector
        return True


def _owner(port: Port[Any]) -> str:
    return port.path.partition(".")[0]


def _between(out: OutPort[Any], in_: InPort[Any]) -> Connector | None:
    fewer = out.connectors if len(out.connectors) <= len(in_.connectors) else in_.connectors
    return next((one for one in fewer if one.out is out and one.in_ is in_), None)
