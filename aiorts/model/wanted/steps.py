"""The steps by which one system becomes another: frozen values that can be reversed, each one line of text.

A step has the part of the system before it and after it, so it can be reversed without other knowledge.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field, fields
from types import MappingProxyType
from typing import Any, ClassVar, Final, Self, TypeVar

from aiorts.late import dataclass
from aiorts.model.plain import plain
from aiorts.model.wanted.entries import (
    CHANGED_BY_RULE,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    said_keys,
)
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.model.wanted.start_rules import StartRule

T = TypeVar("T")
_SHOWN: Final = 5
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Step:
    """One change of a system."""

    sign: ClassVar[str] = "~"
    """+ for a part that comes, - for one that goes, ~ for one that is changed."""

    def reverse(self) -> Step:
        """The step that takes this one back."""
        raise NotImplementedError

    @property
    def text(self) -> str:
        """The step in one line."""
        raise NotImplementedError

    def to_plain(self) -> dict[str, Any]:
        """The step as JSON has it."""
        return {"step": type(self).__name__, "sign": self.sign, "text": self.text, **plain(self)}


# -- what comes and goes -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Create(Step):
    """Make a component, in no context."""

    sign: ClassVar[str] = "+"
    component: ComponentEntry

    def reverse(self) -> Remove:
        return Remove(self.component)

    @property
    def text(self) -> str:
        return f"create {self.component.name} ({short(self.component.type)})"


@dataclass(frozen=True, slots=True)
class Remove(Step):
    """Take a component out, which is in no context and has no connector any more."""

    sign: ClassVar[str] = "-"
    component: ComponentEntry

    def reverse(self) -> Create:
        return Create(self.component)

    @property
    def text(self) -> str:
        return f"remove {self.component.name} ({short(self.component.type)})"


@dataclass(frozen=True, slots=True)
class Connect(Step):
    """Make a connector."""

    sign: ClassVar[str] = "+"
    name: str
    connection: ConnectionEntry

    def reverse(self) -> Disconnect:
        return Disconnect(self.name, self.connection)

    @property
    def text(self) -> str:
        options = ", ".join(f"{word} {_value(value)}" for word, value in self.connection.options.items())
        return f"connect {_ends(self.connection)}{f' ({options})' if options else ''}"


@dataclass(frozen=True, slots=True)
class Disconnect(Step):
    """End a connector."""

    sign: ClassVar[str] = "-"
    name: str
    connection: ConnectionEntry

    def reverse(self) -> Connect:
        return Connect(self.name, self.connection)

    @property
    def text(self) -> str:
        return f"disconnect {_ends(self.connection)}"


@dataclass(frozen=True, slots=True)
class StartContext(Step):
    """Start a context; its members join it by `Move`."""

    sign: ClassVar[str] = "+"
    context: ContextEntry

    def reverse(self) -> StopContext:
        return StopContext(self.context)

    @property
    def text(self) -> str:
        return f"start context {_context(self.context)}"


@dataclass(frozen=True, slots=True)
class StopContext(Step):
    """Stop a context, which has no member any more."""

    sign: ClassVar[str] = "-"
    context: ContextEntry

    def reverse(self) -> StartContext:
        return StartContext(self.context)

    @property
    def text(self) -> str:
        return f"stop context {_context(self.context)}"


# -- what is changed ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Change(Step):
    """A step that changes a part of the system from `before` to `after`."""

    def reverse(self) -> Self:
        given = {one.name: getattr(self, one.name) for one in fields(self)}
        return type(self)(**{**given, "before": given["after"], "after": given["before"]})


@dataclass(frozen=True, slots=True)
class _ComponentChange(_Change):
    """A step that changes a component from one entry to another of the same name."""

    before: ComponentEntry
    after: ComponentEntry


@dataclass(frozen=True, slots=True)
class Configure(_ComponentChange):
    """Put parameters, sets or the active set in force, between two cycles."""

    @property
    def text(self) -> str:
        return f"configure {self.after.name}: {_differences(_settings(self.before), _settings(self.after))}"


@dataclass(frozen=True, slots=True)
class Reload(_ComponentChange):
    """Put an instance of another type in the component's place, or of the newer code of its type."""

    @property
    def text(self) -> str:
        change = _changed(short(self.before.type), short(self.after.type))
        return f"reload {self.after.name}: {change if self.before.type != self.after.type else 'newer code'}"


@dataclass(frozen=True, slots=True)
class Isolate(_ComponentChange):
    """Put a component that is in no context into a process of its own, or back into that of its kernel."""

    connectors: tuple[str, ...] = ()
    """The names of its connectors, which are made again."""

    @property
    def text(self) -> str:
        limits = ", ".join(f"{word} {_value(value)}" for word, value in self.after.limits.items())
        there = f"the kernel's process -> one of its own{f' ({limits})' if limits else ''}"
        where = there if self.after.isolation else "a process of its own -> the kernel's"
        anew = f"; counts begin at 0: {_listed(self.connectors)}" if self.connectors else ""
        return f"isolate {self.after.name}: {where}{anew}"


@dataclass(frozen=True, slots=True)
class Supervise(_ComponentChange):
    """Change the rules for a component's failure, start, replacement, or loss of its operator."""

    @property
    def text(self) -> str:
        return f"supervise {self.after.name}: {_differences(_rules(self.before), _rules(self.after))}"


@dataclass(frozen=True, slots=True)
class AddRules(_Change):
    """Add rules of `[[rules]]` after the present ones."""

    before: tuple[Mapping[str, Any], ...]
    after: tuple[Mapping[str, Any], ...]

    @property
    def text(self) -> str:
        few, many = sorted((self.before, self.after), key=len)
        names = ", ".join(f"{one['from']} to {one['to']}" for one in many[len(few) :])
        return f"{'add' if few is self.before else 'take away'} rules: {names}"


@dataclass(frozen=True, slots=True)
class _ConnectorChange(_Change):
    """A step that changes the options of a connector."""

    name: str
    before: ConnectionEntry
    after: ConnectionEntry
    usual: Mapping[str, Any] = field(default_factory=lambda: _NOTHING)
    """The defaults of connectors to another kernel or process, if this is one; else nothing."""

    @property
    def _options(self) -> str:
        return _differences({**self.usual, **self.before.options}, {**self.usual, **self.after.options})


@dataclass(frozen=True, slots=True)
class Change(_ConnectorChange):
    """Change options of a connector in place: no sample is touched."""

    @property
    def text(self) -> str:
        return f"change {_ends(self.after)}: {self._options}"


@dataclass(frozen=True, slots=True)
class Renew(_ConnectorChange):
    """Replace a connector by one with other options; waiting writes and unread samples go over, in order.

    Where only the newest sample counts afterwards, older ones are superseded.
    """

    @property
    def text(self) -> str:
        # Both kernels negotiate a new link, and its connector is a new one.
        anew = "; counts begin at 0" if self.usual else ""
        return f"renew {_ends(self.after)}: {self._options}{anew}"


@dataclass(frozen=True, slots=True)
class Retime(_Change):
    """Change the rate of a context."""

    before: ContextEntry
    after: ContextEntry

    @property
    def text(self) -> str:
        return f"retime {self.after.name}: {_differences(self.before.options, self.after.options)}"


@dataclass(frozen=True, slots=True)
class RenewContext(_Change):
    """Replace a context by one of another kind, or with other options; its members go over."""

    before: ContextEntry
    after: ContextEntry

    @property
    def text(self) -> str:
        before = {"kind": self.before.kind, **self.before.options}
        after = {"kind": self.after.kind, **self.after.options}
        return f"renew context {self.after.name}: {_differences(before, after)}"


@dataclass(frozen=True, slots=True)
class Activate(_Change):
    """Activate the members of a context, or deactivate them."""

    context: str
    before: bool
    after: bool

    @property
    def text(self) -> str:
        return f"{'activate' if self.after else 'deactivate'} the members of {self.context}"


@dataclass(frozen=True, slots=True)
class Places:
    """The members of contexts and composites, as far as a step is about them."""

    contexts: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: _NOTHING)
    """The members of contexts."""
    composites: Mapping[str, CompositeEntry | None] = field(default_factory=lambda: _NOTHING)
    """The composites by name; None for one that does not exist."""


@dataclass(frozen=True, slots=True)
class Move(_Change):
    """Change the members of contexts and composites, and their order: in all of them between the same two cycles."""

    before: Places
    after: Places

    @property
    def text(self) -> str:
        parts: list[str] = []
        for name, members in self.after.contexts.items():
            parts += _membership(name, self.before.contexts.get(name, ()), members)
        for name, composite in self.after.composites.items():
            old = self.before.composites.get(name)
            if old is None or composite is None:
                one = composite or old
                sign, members = "-+"[composite is not None], () if one is None else one.members
                parts.append(f"{sign}composite {name} ({_listed(members)})")
                continue
            parts += _membership(name, old.members, composite.members)
            if (before := said_keys(old)) != (after := said_keys(composite)):
                parts.append(f"{name}: {_differences(before, after)}")
        return f"move {'; '.join(parts)}"


# -- texts -------------------------------------------------------------------------------------------------------------


def short(type_text: str) -> str:
    """A type without the folders of its file."""
    return type_text.rpartition("/")[2]


def _settings(one: ComponentEntry) -> dict[str, Any]:
    sets = {f"sets.{name}": dict(values) for name, values in one.sets.items()}
    return {**{f"params.{name}": value for name, value in one.params.items()}, **sets, "active": one.active}


def _rules(one: ComponentEntry) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for word, value in said_keys(one).items():
        if isinstance(value, Supervision | StartRule):
            found |= {f"{word}.{key}": said for key, said in said_keys(value).items()}
        elif word in CHANGED_BY_RULE:
            found[word] = value
    return found


def _ends(connection: ConnectionEntry) -> str:
    return f"{connection.ports[0]} -> {', '.join(connection.ports[1:])}"


def _context(context: ContextEntry) -> str:
    rate = context.options.get("rate")
    return f"{context.name} ({context.kind}{f', {_value(rate)} Hz' if rate is not None else ''})"


def _membership(name: str, before: tuple[str, ...], after: tuple[str, ...]) -> Iterator[str]:
    come = [one for one in after if one not in before]
    gone = [one for one in before if one not in after]
    if come or gone:
        yield f"{name}: {' '.join(filter(None, (f'+{_listed(come)}' * bool(come), f'-{_listed(gone)}' * bool(gone))))}"
    elif before != after:
        yield f"{name}: order {_listed(after)}"


def _listed(names: Any) -> str:
    found = list(names)
    return ", ".join(found[:_SHOWN]) + (f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else "")


def _differences(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    words = [word for word in {**before, **after} if before.get(word) != after.get(word)]
    return ", ".join(f"{word} {_changed(_value(before.get(word)), _value(after.get(word)))}" for word in words)


def _changed(before: str, after: str) -> str:
    return f"{before or 'default'} -> {after or 'default'}"


def _value(value: Any) -> str:
    if value is None or value == "":
        return ""
    text = value if isinstance(value, str) else str(plain(value))
    return text if len(text) <= 60 else f"{text[:57]}..."
