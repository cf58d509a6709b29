"""Orders the start of components by rules with conditions. Pure.

A condition is text: "camera active", or another lifecycle state, or "camera added". Rules are carried out one after the
other: each comes after the rules of the components that its conditions name, otherwise in the order given. Stopping is
the reverse.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts.model.declared import check_declared, option
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.names import check_name
from aiorts.model.values import shown

ADDED: Final = "added"
_STATES: Final = (ADDED, *(state.value for state in LifecycleState))


@dataclass(frozen=True, slots=True)
class Condition:
    """A condition: a component has a state in every context it is in; "added": it exists."""

    component: str
    state: str

    @classmethod
    def parse(cls, text: object) -> Condition:
        """Read "camera active"; "camera" alone means active.

        Raises:
            ConfigurationError: the text is no condition.
            InvalidNameError: the component's name is none.
        """
        words = text.split() if isinstance(text, str) else []
        if len(words) not in (1, 2) or words[1:2] not in ([], *([state] for state in _STATES)):
            raise ConfigurationError(
                f'condition {text!r}: expected a component and one of {", ".join(_STATES)}, such as "camera active"'
            )
        return cls(check_name(words[0], "component"), words[1] if len(words) == 2 else LifecycleState.ACTIVE.value)

    def __str__(self) -> str:
        return f"{self.component} {self.state}"


@dataclass(frozen=True, slots=True)
class StartRule:
    """The rule by which `Kernel.start_in_order` activates a component.

    Attributes:
        component: the component's name.

    Raises:
        ConfigurationError: a value is wrong; names it.
        InvalidNameError: `component` is no name.
    """

    component: str
    after: str | Sequence[str] = option(
        (), 'Conditions that come first, such as "camera active": another lifecycle state, or "added".'
    )
    wait: float = option(0.0, "The time from the last condition to the activation.", unit="s", low=0)
    timeout: float = option(10.0, "The time that all conditions together may take.", unit="s", low=0)

    def __post_init__(self) -> None:
        check_name(self.component, "component")
        try:
            check_declared(self)
        except ConfigurationError as error:
            raise ConfigurationError(f"{self.component}: {error}") from None
        if not isinstance(self.after, str | Sequence):
            raise ConfigurationError(f"{self.component}: after = {self.after!r}: expected a condition or several")
        given = (self.after,) if isinstance(self.after, str) else tuple(self.after)
        object.__setattr__(self, "after", given)
        for condition in self.conditions:
            if condition.component == self.component and condition.state != ADDED:
                raise ConfigurationError(f"{self.component}: cannot wait for itself ({condition})")

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions of `after`."""
        return tuple(Condition.parse(text) for text in self.after)


def in_order(rules: Sequence[StartRule]) -> tuple[StartRule, ...]:
    """The rules in an order where each comes after the rules for which it waits, and otherwise as given.

    Raises:
        ConfigurationError: these are no rules, two are for one component, or some wait for each other; names them.
    """
    by_name: dict[str, StartRule] = {}
    if not isinstance(rules, Sequence) or not all(isinstance(rule, StartRule) for rule in rules):
        raise ConfigurationError(f'{shown(rules)}: expected rules, such as [StartRule("camera"), ...]')
    for rule in rules:
        if rule.component in by_name:
            raise ConfigurationError(f"{rule.component}: there are two rules for it")
        by_name[rule.component] = rule
    waits = {
        name: [condition.component for condition in rule.conditions if condition.component in by_name]
        for name, rule in by_name.items()
    }
    # A component that waits only for its own addition delays no other component.
    left = {name: set(others) - {name} for name, others in waits.items()}
    ordered: list[StartRule] = []
    while left:
        ready = next((name for name, others in left.items() if not others), None)
        if ready is None:
            raise ConfigurationError(f"wait for each other, and none can be first: {' -> '.join(_cycle(left))}")
        del left[ready]
        for others in left.values():
            others.discard(ready)
        ordered.append(by_name[ready])
    return tuple(ordered)


def _cycle(waits: Mapping[str, set[str]]) -> list[str]:
    """One cycle of components that wait for each other, with its first name repeated at the end."""
    name = next(iter(waits))
    way: list[str] = []
    while name not in way:
        way.append(name)
        name = min(waits[name])
    return [*way[way.index(name) :], name]
