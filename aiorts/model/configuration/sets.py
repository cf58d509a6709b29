"""Configuration sets as one frozen value: every change makes another value, whole and checked, or raises.

There is always the set "default", which has a value for every parameter. Every other set names some parameters; the
others are as in "default". So the values in force depend on the active set alone, never on which one was
active before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import ConfigurationError, InvalidNameError
from aiorts.late import dataclass
from aiorts.model.configuration.parameters import ParameterSpec, check_mapping, validate
from aiorts.model.names import check_name
from aiorts.spelling import suggestion

DEFAULT: Final = "default"
"""The set that is always there."""

Values = Mapping[str, Any]
_NO_VALUES: Final[Values] = MappingProxyType({})


def same(one: object, other: object) -> bool:
    """Whether two values of a parameter are identical: 0.0 is not -0.0, and NaN is NaN."""
    if type(one) is not type(other):
        return False
    if isinstance(one, float):
        return repr(one) == repr(other)
    if isinstance(one, tuple) and isinstance(other, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return list(one) == list(other) and all(same(value, other[key]) for key, value in one.items())
    return one == other


def check_set_name(name: object) -> str:
    """The name itself when a configuration set may have it; InvalidNameError otherwise."""
    checked = check_name(name, "configuration set")
    if checked.startswith("_"):
        raise InvalidNameError(
            f"configuration set name {checked!r}: names that begin with '_' are not for sets of values"
        )
    return checked


@dataclass(frozen=True, slots=True)
class ConfigurationState:
    """The parameters of one component, its sets, and which set is active.

    A method that makes a change returns another state; this one stays as it is. A refused change raises
    ConfigurationError (or InvalidNameError), which names `owner` and every fault.
    """

    specs: Mapping[str, ParameterSpec]
    sets: Mapping[str, Values]
    """The sets by name, "default" first; the others hold only the parameters that they name."""
    active: str = DEFAULT
    values: Values = field(init=False, compare=False, repr=False)
    """The values in force."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", MappingProxyType(values_in_force(self.sets, self.active)))

    @classmethod
    def of(cls, specs: Mapping[str, ParameterSpec]) -> ConfigurationState:
        """The state as declared: the set "default" alone, each parameter at its default."""
        return cls(specs, MappingProxyType({DEFAULT: _defaults(specs)}))

    # -- values ----------------------------------------------------------------------------------------------------

    def changed(
        self,
        changes: Mapping[str, object],
        name: str | None = None,
        owner: str = "",
        *,
        kept: Mapping[str, object] | None = None,
    ) -> ConfigurationState:
        """The state with these values in the set `name`; the active set by default.

        Args:
            kept: the values that the message of a refusal calls kept; those of the set in this state by default.
        """
        target = self.active if name is None else self._known(name, owner)
        check_mapping(changes, owner)
        if not changes:
            return self
        old = self.sets[target]
        whose = owner if target == self.active else f"{owner} (set {target})"
        current = values_in_force(self.sets, target) if kept is None else kept
        return self._with(target, {**old, **validate(self.specs, changes, owner=whose, current=current)})

    # -- sets ------------------------------------------------------------------------------------------------------

    def added(
        self, name: str, values: Mapping[str, object], owner: str = "", *, replace: bool = False
    ) -> ConfigurationState:
        """The state with another set; with `replace` it may take the place of a set of that name."""
        check_set_name(name)
        if name == DEFAULT:
            raise ConfigurationError(f"{owner}: the set {DEFAULT!r} is always there; change its values")
        if name in self.sets and not replace:
            raise ConfigurationError(f"{owner}: there is a set {name!r} already; change it, or replace it")
        return self._with(name, validate(self.specs, values, owner=f"{owner} (set {name})"))

    def removed(self, name: str, owner: str = "") -> ConfigurationState:
        """The state without a set; neither "default" nor the active set can be removed."""
        self._known(name, owner)
        if name == DEFAULT or name == self.active:
            why = "is always there" if name == DEFAULT else "is active; activate another first"
            raise ConfigurationError(f"{owner}: the set {name!r} cannot be removed: it {why}")
        return self._but(sets={other: values for other, values in self.sets.items() if other != name})

    def activated(self, name: str, owner: str = "") -> ConfigurationState:
        """The state with another set in force."""
        return self._but(active=self._known(name, owner))

    def replaced(
        self, sets: Mapping[str, Mapping[str, object]], active: str = DEFAULT, owner: str = ""
    ) -> ConfigurationState:
        """The state with these sets alone; parameters that `sets["default"]` does not name are as declared."""
        return ConfigurationState.of(self.specs).merged(sets, active, owner)

    def merged(
        self, sets: Mapping[str, Mapping[str, object]], active: str | None = None, owner: str = ""
    ) -> ConfigurationState:
        """The state with these values in "default"; each other set is added, or replaces the set of its name."""
        check_mapping(sets, owner, "sets by name")
        merged, faults = self, []
        for name, values in sets.items():
            try:
                if name == DEFAULT:
                    merged = merged.changed(values, DEFAULT, owner)
                else:
                    merged = merged.added(name, values, owner, replace=True)
            except (ConfigurationError, InvalidNameError) as error:
                faults.append(str(error))
        if faults:
            raise ConfigurationError("\n".join(faults))
        return merged if active is None else merged.activated(active, owner)

    # -- parameters ------------------------------------------------------------------------------------------------

    def with_parameter(self, spec: ParameterSpec, owner: str = "") -> ConfigurationState:
        """The state with one parameter more, at its default."""
        if spec.name in self.specs:
            raise ConfigurationError(f"{owner}.{spec.name}: there is a parameter of that name already")
        sets = dict(self.sets)
        sets[DEFAULT] = MappingProxyType({**sets[DEFAULT], spec.name: spec.default})
        return ConfigurationState(
            MappingProxyType({**self.specs, spec.name: spec}), MappingProxyType(sets), self.active
        )

    def without_parameter(self, name: str, owner: str = "") -> ConfigurationState:
        """The state with one parameter less, in every set."""
        if name not in self.specs:
            raise ConfigurationError(f"{owner}.{name}: no such parameter{_hint(name, self.specs)}")
        specs = {other: spec for other, spec in self.specs.items() if other != name}
        sets = {
            set_name: MappingProxyType({other: value for other, value in values.items() if other != name})
            for set_name, values in self.sets.items()
        }
        return ConfigurationState(MappingProxyType(specs), MappingProxyType(sets), self.active)

    # -- helpers ---------------------------------------------------------------------------------------------------

    def _known(self, name: object, owner: str) -> str:
        if isinstance(name, str) and name in self.sets:
            return name
        raise ConfigurationError(f"{owner}: no set {name!r:.80}{_hint(name, self.sets)}")

    def _with(self, name: str, values: Values) -> ConfigurationState:
        return self._but(sets={**self.sets, name: MappingProxyType(dict(values))})

    def _but(self, sets: Mapping[str, Values] | None = None, active: str | None = None) -> ConfigurationState:
        return ConfigurationState(
            self.specs,
            self.sets if sets is None else MappingProxyType(sets),
            self.active if active is None else active,
        )


def values_in_force(sets: Mapping[str, Values], active: str) -> dict[str, Any]:
    """The values when `active` is the active set."""
    return {**sets[DEFAULT], **(sets[active] if active != DEFAULT else _NO_VALUES)}


def _defaults(specs: Mapping[str, ParameterSpec]) -> Values:
    return MappingProxyType({name: spec.default for name, spec in specs.items()})


def _hint(name: object, known: Mapping[str, Any]) -> str:
    return f"; {suggestion(name, known, shown=str, most=3)}"


@dataclass(frozen=True, slots=True)
class Difference:
    """A difference of two configurations: `old` is None for an added thing, `new` for a removed one.

    `kind` is "added", "removed" or "changed"; `what` is "component", "set", "value" or "active".
    """

    kind: str
    what: str
    component: str
    set: str = ""
    parameter: str = ""
    old: Any = None
    new: Any = None

    def __str__(self) -> str:
        """One line: "pid0 stiff.gain: 2.0 -> 5.0"."""
        place = f"{self.component} {'.'.join(part for part in (self.set, self.parameter) if part) or self.what}"
        if self.what in ("set", "component"):
            return f"{place if self.set else self.component}: {self.what} {self.kind}"
        old = "not there" if self.kind == "added" else repr(self.old)
        new = "not there" if self.kind == "removed" else repr(self.new)
        return f"{place}: {old} -> {new}"


def differences(
    component: str, old: Mapping[str, Values], new: Mapping[str, Values], active: tuple[str, str] = (DEFAULT, DEFAULT)
) -> tuple[Difference, ...]:
    """The differences when the sets `new` take the place of `old`; `active` are the old and the new active set."""
    found = []
    for name in {**old, **new}:
        before, after = old.get(name), new.get(name)
        if before is None or after is None:
            found.append(Difference("added" if before is None else "removed", "set", component, name))
        found += _value_differences(component, name, before or _NO_VALUES, after or _NO_VALUES)
    if active[0] != active[1]:
        found.append(Difference("changed", "active", component, old=active[0], new=active[1]))
    return tuple(found)


def _value_differences(component: str, name: str, old: Values, new: Values) -> list[Difference]:
    found = []
    for parameter in {**old, **new}:
        if parameter not in old:
            found.append(Difference("added", "value", component, name, parameter, None, new[parameter]))
        elif parameter not in new:
            found.append(Difference("removed", "value", component, name, parameter, old[parameter], None))
        elif not same(old[parameter], new[parameter]):
            found.append(Difference("changed", "value", component, name, parameter, old[parameter], new[parameter]))
    return found
