"""Decides the ports that a composite exports and their names, its state, order and groups.

Pure functions of names and states.
"""

from __future__ import annotations

import string
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase

from aiorts.errors import ConfigurationError, InvalidNameError, WiringError
from aiorts.late import dataclass
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.names import check_name
from aiorts.model.policy import ErrorPolicy
from aiorts.model.values import shown as shown_value

_ACTIVE, _ERROR, _INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE

STATES: Mapping[tuple[bool, bool, ErrorPolicy], LifecycleState] = {
    (in_error, active, policy): (
        _ERROR if in_error and (not active or policy is not ErrorPolicy.ISOLATE) else _ACTIVE if active else _INACTIVE
    )
    for in_error in (False, True)
    for active in (False, True)
    for policy in ErrorPolicy
}
"""(Whether a member is in error, whether one is active, policy) -> the composite's state."""


def derived(states: Iterable[LifecycleState], policy: ErrorPolicy) -> LifecycleState | None:
    """The state of a composite whose members have these states; None when none of them is in a context."""
    there = frozenset(states)
    return STATES[_ERROR in there, _ACTIVE in there, policy] if there else None


# -- exported ports ------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Export:
    """One rule: ports whose "component.port" fits the pattern are exported under a name made from the template."""

    component: str
    port: str
    name: str
    """The template, which may contain {component} and {port}."""

    @property
    def literal(self) -> bool:
        """Whether the rule names exactly one port, without wildcards."""
        return not any(mark in self.component + self.port for mark in "*?[")

    @property
    def pattern(self) -> str:
        """The pattern as it was written."""
        return f"{self.component}.{self.port}"

    def fits(self, component: str, port: str) -> bool:
        """Whether the rule exports this port."""
        return fnmatchcase(component, self.component) and fnmatchcase(port, self.port)


def exports(given: Mapping[str, str] | Iterable[str], where: str) -> tuple[Export, ...]:
    """Parse rules written as `{"*.command": "{component}_command", "arm.force": "force"}` or `["arm.force"]`.

    A rule for one port comes before patterns, patterns come in the order they are written.

    Raises:
        ConfigurationError: a rule cannot be parsed; `where` begins the message.
    """
    if not isinstance(given, Iterable):
        raise ConfigurationError(f"{where}: exported = {shown_value(given)}: expected patterns, or names by pattern")
    if isinstance(given, str):
        given = [part.strip() for part in given.split(",") if part.strip()]
    pairs = given.items() if isinstance(given, Mapping) else [(pattern, "{port}") for pattern in given]
    rules = [_rule(pattern, name, where) for pattern, name in pairs]
    return tuple(sorted(rules, key=lambda rule: not rule.literal))


def _rule(pattern: object, name: object, where: str) -> Export:
    if not isinstance(pattern, str) or pattern.count(".") != 1 or pattern.startswith(".") or pattern.endswith("."):
        raise ConfigurationError(f"{where}: exported {pattern!r}: expected component.port, each may hold * and ?")
    if not isinstance(name, str):
        raise ConfigurationError(f"{where}: exported {pattern!r}: expected a name, got {name!r}")
    try:
        fields = {field for _, field, _, _ in string.Formatter().parse(name) if field is not None}
    except ValueError as error:
        raise ConfigurationError(f"{where}: exported {pattern!r} = {name!r}: {error}") from None
    if not fields <= {"component", "port"}:
        raise ConfigurationError(
            f"{where}: exported {pattern!r} = {name!r}: only {{component}} and {{port}} can be filled in"
        )
    component, _, port = pattern.partition(".")
    rule = Export(component, port, name)
    try:
        check_name(_named(rule, "c", "p"), "exported port")
    except InvalidNameError as error:
        raise ConfigurationError(f"{where}: exported {pattern!r}: {error}") from None
    return rule


def _named(rule: Export, component: str, port: str) -> str:
    return rule.name.replace("{component}", component).replace("{port}", port)


def shown(rules: Sequence[Export], ports: Iterable[tuple[str, str]], where: str) -> dict[str, tuple[str, str]]:
    """Exported name -> (component, port), for the existing ports, in their order; each port is exported at most once.

    Raises:
        WiringError: two ports would have one name; the message names both ports.
    """
    found: dict[str, tuple[str, str]] = {}
    for component, port in ports:
        rule = next((rule for rule in rules if rule.fits(component, port)), None)
        if rule is None:
            continue
        name = check_name(_named(rule, component, port), "exported port")
        if name in found:
            raise WiringError(
                f"{where}: {'.'.join(found[name])} and {component}.{port} would both be exported as {name!r}; "
                f'name them apart: exported = {{"{rule.pattern}": "{{component}}_{{port}}"}}'
            )
        found[name] = component, port
    return found


# -- order and groups ----------------------------------------------------------------------------------------------


def flow_order(names: Sequence[str], edges: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """`names` with writers before their readers, otherwise in the given order.

    `edges` are (writer, reader). A loop is cut at the member that was given first.
    """
    before: dict[str, set[str]] = {name: set() for name in names}
    for writer, reader in edges:
        if writer in before and reader in before and writer != reader:
            before[reader].add(writer)
    left = list(names)
    order: list[str] = []
    while left:
        free = next((name for name in left if not before[name]), None)
        if free is None:
            free = next(name for name in left if _in_loop(name, before))
        left.remove(free)
        order.append(free)
        for waiting in before.values():
            waiting.discard(free)
    return tuple(order)


def _in_loop(name: str, before: Mapping[str, set[str]]) -> bool:
    """Whether edges lead from a member back to itself; false for a member that only depends on a loop."""
    seen: set[str] = set()
    todo = list(before[name])
    while todo:
        one = todo.pop()
        if one == name:
            return True
        if one not in seen:
            seen.add(one)
            todo += before[one]
    return False


def groups_of(text: str | Sequence[Sequence[str]], members: Sequence[str], where: str) -> tuple[tuple[str, ...], ...]:
    """Parse groups written as "a,b|c,d" (or as sequences of names): `|` separates the groups that run side by side.

    Every member is in one group; an empty text means no groups.

    Raises:
        ConfigurationError: a name is unknown, missing or given twice; the message has that name.
    """
    if isinstance(text, str):
        parts = text.split("|") if text.strip() else []
        groups = tuple(tuple(name.strip() for name in part.split(",") if name.strip()) for part in parts)
    elif isinstance(text, Iterable) and all(isinstance(part, list | tuple) for part in text):
        groups = tuple(tuple(part) for part in text)
    else:
        raise ConfigurationError(f'{where}: groups = {shown_value(text)}: expected groups of names, such as "a,b|c"')
    if not groups:
        return ()
    named = [name for group in groups for name in group]
    unknown = [name for name in named if name not in members]
    missing = [name for name in members if name not in named]
    twice = sorted({name for name in named if named.count(name) > 1})
    for wrong, what in ((unknown, "no member"), (missing, "in no group"), (twice, "in two places")):
        if wrong:
            raise ConfigurationError(f"{where}: groups = {text!r}: {', '.join(map(str, wrong))}: {what}")
    if not all(groups):
        raise ConfigurationError(f"{where}: groups = {text!r}: a group is empty")
    return groups
