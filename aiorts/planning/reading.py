"""Reads a kernel into `Wanted`: what would have to stand in a system file so that this system is made of it.

Only what was chosen is in it: what is as a class declares it, or as an option is by default, is left out.
"""

from __future__ import annotations

import dataclasses
import enum
import inspect
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import SimulatedClock
from aiorts.composites import Composite, group_of
from aiorts.errors import ConfigurationError, SystemFileError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.extensions.arguments import needs_rate, path_settings
from aiorts.kernel.extensions.type_texts import type_text
from aiorts.model.configuration.sets import DEFAULT, same
from aiorts.model.converter import Converter
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.options import chosen_options
from aiorts.model.wanted.entries import (
    ClockEntry,
    ComponentEntry,
    CompositeEntry,
    ConnectionEntry,
    ContextEntry,
    Wanted,
)
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.planning.planning import Planning
from aiorts.supervision import Supervising

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.services import ServiceConnector

_SHOWN: Final = 20
_MISSING: Final = object()
_NO_RULES: Final[Mapping[str, Any]] = MappingProxyType({})


def wanted_of(kernel: Microkernel, notes: list[str] | None = None) -> Wanted:
    """The system of a kernel at this moment.

    Args:
        notes: gets what of the system no system file can say and is left out.

    Raises:
        SystemFileError: names each component, converter and context of which a system file cannot be made.
    """
    return _Reader(kernel, [] if notes is None else notes).wanted()


class _Reader:
    """Reads one kernel once."""

    def __init__(self, kernel: Microkernel, notes: list[str]) -> None:
        self._kernel = kernel
        self._notes = notes
        self._faults: list[str] = []
        self._types: dict[Any, str] = {}
        supervising = kernel.attached(Supervising)
        self._supervised = {} if supervising is None else supervising.supervised
        self._rules = _NO_RULES if supervising is None else supervising.rules

    def wanted(self) -> Wanted:
        kernel = self._kernel
        there = [one for one in kernel.components.values() if not kernel.registry.is_arriving(one)]
        composites = [one for one in there if isinstance(one, Composite)]
        components = {one.name: self._component(one) for one in there if not isinstance(one, Composite)}
        made = Wanted(
            components=MappingProxyType(components),
            connections=tuple(self._connections()),
            contexts=MappingProxyType({name: self._context(one) for name, one in kernel.contexts.items()}),
            clock=self._clock(),
            composites=MappingProxyType({one.name: self._composite(one) for one in composites}),
            services=MappingProxyType(dict(self._services())),
            plugin_paths=tuple(_whole(folder) for folder in kernel.plugins.folders),
        )
        if self._faults:
            more = f"\nand {len(self._faults) - _SHOWN} more" if len(self._faults) > _SHOWN else ""
            raise SystemFileError("\n".join(self._faults[:_SHOWN]) + more)
        return made

    def _type(self, thing: Any, kind: str) -> str:
        text = self._types.get(thing)
        if text is None:
            text = self._types[thing] = type_text(thing, self._kernel.plugins, kind)
        return text

    # -- components ------------------------------------------------------------------------------------------------

    def _component(self, component: Component) -> ComponentEntry:
        cls, name = type(component), component.name
        text = self._type(cls, "components")
        if not text:
            what = f"its class {cls.__qualname__} is in no file, and no plugin offers it"
            self._faults.append(f"{name}: {what}; write it at the top of a FILE.py")
        elif needed := _needed_arguments(cls):
            self._faults.append(
                f"{name}: {cls.__qualname__} takes {needed}, which no system file gives; use parameters"
            )
        state = cell(component).configuration
        declared = declarations(cls).configuration
        supervised = self._supervised.get(name)
        return ComponentEntry(
            name,
            text,
            self._params(name, state, declared),
            (),
            self._sets(name, state, declared),
            state.active if state.active != declared.active else "",
            supervised.policy if supervised is not None and supervised.policy != Supervision() else None,
            self._rules.get(name),
        )

    def _params(self, name: str, state: ConfigurationState, declared: ConfigurationState) -> Mapping[str, Any]:
        found = {}
        for param, value in state.sets[DEFAULT].items():
            usual = declared.sets[DEFAULT].get(param, state.specs[param].default)
            if same(value, usual):
                continue
            if param not in declared.specs:
                self._notes.append(f"{name}.{param} = {value!r:.80}: the parameter was added at run time")
            elif self._reads_back(name, param, value, declared):
                found[param] = _plain(value)
        return MappingProxyType(found)

    def _sets(
        self, name: str, state: ConfigurationState, declared: ConfigurationState
    ) -> Mapping[str, Mapping[str, Any]]:
        found = {}
        for set_name, values in state.sets.items():
            usual = declared.sets.get(set_name)
            if set_name != DEFAULT and (usual is None or not same(dict(values), dict(usual))):
                known = {param: value for param, value in values.items() if param in declared.specs}
                found[set_name] = MappingProxyType(
                    {
                        param: _plain(value)
                        for param, value in known.items()
                        if self._reads_back(name, param, value, declared)
                    }
                )
        for set_name in declared.sets:
            if set_name not in state.sets:
                self._notes.append(f"{name}: the set {set_name!r} of its class was removed, and is there again")
        return MappingProxyType(found)

    def _reads_back(self, name: str, param: str, value: Any, declared: ConfigurationState) -> bool:
        """Whether a value is the same again when it is read from a file."""
        try:
            again = declared.specs[param].check(_as_read(_plain(value)))
        except ConfigurationError as error:
            self._faults.append(f"{name}.{param}: its value would be refused: {error}")
            return False
        if not isinstance(value, Path) and not same(again, value):
            self._faults.append(f"{name}.{param} = {value!r:.80}: no text of TOML is read back as this value")
            return False
        return True

    # -- composites and contexts -----------------------------------------------------------------------------------

    def _composite(self, composite: Composite) -> CompositeEntry:
        if type(composite) is not Composite:
            what = f"a composite of a class of its own, {type(composite).__qualname__}"
            self._faults.append(f"{composite.name}: is {what}; make it of Composite")
        group = group_of(composite)
        options: dict[str, Any] = {}
        if composite.order != "stated":
            options["order"] = composite.order
        if composite.groups:
            options["groups"] = composite.groups
        if composite.errors != "stop":
            options["errors"] = str(composite.errors)
        if composite.own_schedule:
            options["own_schedule"] = True
        if group is not None and group.exports:
            options["exported"] = {rule.pattern: rule.name for rule in group.exports}
        members = tuple(member.name for member in composite.members)
        return CompositeEntry(composite.name, members, MappingProxyType(options), named=True)

    def _context(self, context: Context) -> ContextEntry:
        kind, name = type(context), context.name
        text = self._type(kind, "contexts")
        if text != context.kind:
            what = f"no plugin offers {kind.__qualname__} as the kind of context {context.kind!r}"
            self._faults.append(f"{name}: {what}; declare it as an entry point aiorts.contexts")
        options = {}
        always = ("rate",) if needs_rate(kind) else ()
        for argument, parameter in inspect.signature(kind).parameters.items():
            value = getattr(context, argument, _MISSING)
            if argument == "name" or parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if value is _MISSING and parameter.default is parameter.empty:
                what = f"its {context.kind} context needs {argument}, and does not have it as an attribute"
                self._faults.append(f"{name}: {what}; keep self.{argument}")
            elif value is _MISSING:
                self._notes.append(f"{name}: {argument} of its {context.kind} context, which does not say it")
            elif argument in always or value != parameter.default:
                if value is None:
                    self._faults.append(f"{name}: {argument} = None cannot be written in TOML; give it a value")
                options[argument] = value
        members = context.runner.members
        shown: dict[str, None] = {}
        for member in members:
            group = cell(member.component).group
            root = None if group is None else group.root
            runs_with = root is not None and context in root.component.contexts  # type: ignore[attr-defined]
            shown[root.name if root is not None and runs_with else member.component.name] = None
        own = [one for one in members if one.component.name not in self._rules]
        idle = [
            one.component.name
            for one in own
            if one.state is LifecycleState.INACTIVE and not one.component.has_finished  # type: ignore[attr-defined]
        ]
        activate = not own or len(idle) < len(own)
        if activate and idle:
            names = ", ".join(idle[:_SHOWN])
            self._notes.append(f"{name}: {names}: not active, and active in the saved system with the others")
        return ContextEntry(name, context.kind, tuple(shown), activate, MappingProxyType(options))

    # -- connections -----------------------------------------------------------------------------------------------

    def _connections(self) -> Iterator[ConnectionEntry]:
        number = 0
        seen: set[tuple[str, ...]] = set()
        for connector in self._kernel.connectors.values():
            number += 1
            ports = (connector.out.path, connector.in_.path)
            options = self._options(connector, ports, again=ports in seen)
            seen.add(ports)
            yield ConnectionEntry(ports, MappingProxyType(options), number)
        for service in self._kernel.service_connectors.values():
            number += 1
            yield ConnectionEntry(service.profile.ports, MappingProxyType(_service_options(service)), number)

    def _options(self, connector: Connector, ports: tuple[str, str], *, again: bool) -> dict[str, Any]:
        profile, usual_name = connector.profile, f"{ports[0]}-{ports[1]}"
        options = chosen_options(profile, connector.in_.length)
        if profile.name != usual_name and not (again and profile.name.startswith(usual_name)):
            options = {"name": profile.name, **options}
        if again:
            options["allow_duplicate"] = True
        converter = profile.convert
        if isinstance(converter, Converter):
            text = self._type(converter.function, "converters")
            if text:
                options["convert"] = text
            elif converter.of_text:
                options["convert"] = str(converter)
            else:
                what = f"its converter {converter} is in no file, and no plugin offers it"
                self._faults.append(f"{profile.name}: {what}; write it as a function at the top of a FILE.py")
        return {**options, **profile.extra}

    # -- the whole -------------------------------------------------------------------------------------------------

    def _services(self) -> Iterator[tuple[str, Mapping[str, Any]]]:
        for service in self._kernel.services:
            if service.table is not None and service.name:
                usual = {one.name: one.default for one in dataclasses.fields(type(service).settings)}
                paths = path_settings(type(service).settings)
                table = {key: _whole(Path(value)) if key in paths else value for key, value in service.table.items()}
                yield service.name, MappingProxyType({k: v for k, v in table.items() if v != usual.get(k, _MISSING)})

    def _clock(self) -> ClockEntry:
        planning, clock = self._kernel.attached(Planning), self._kernel.clock
        if planning is not None and planning.clock is not None:
            return planning.clock
        if isinstance(clock, SimulatedClock):
            return ClockEntry("simulated")
        return ClockEntry() if clock.speed == 1.0 else ClockEntry("scaled", clock.speed)


def _plain(value: Any) -> Any:
    """A parameter's value as a system file has it."""
    if value is None:
        return "none"
    if isinstance(value, Path):
        return _whole(value)
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if isinstance(value, Mapping):
        return MappingProxyType({key: _plain(one) for key, one in value.items()})
    return value


def _as_read(plain: Any) -> Any:
    """What TOML gives for it."""
    if isinstance(plain, tuple):
        return list(map(_as_read, plain))
    if isinstance(plain, Mapping):
        return {key: _as_read(one) for key, one in plain.items()}
    return str(plain) if isinstance(plain, Path) else plain


def _whole(path: Path) -> Path:
    return Path(os.path.abspath(path))


def _needed_arguments(cls: type) -> str:
    """What its constructor cannot be without, besides a name."""
    try:
        arguments = list(inspect.signature(cls).parameters.values())
    except (TypeError, ValueError):
        return ""
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    needed = [one.name for one in arguments[1:] if one.default is one.empty and one.kind not in several]
    return ", ".join(needed)


def _service_options(connector: ServiceConnector) -> dict[str, Any]:
    profile = connector.profile
    options: dict[str, Any] = {}
    if profile.name != f"{profile.ports[0]}-{profile.ports[1]}":
        options["name"] = profile.name
    if not profile.strict:
        options["strict"] = False
    ends = [end for port in connector.ports for end in port.interfaces]
    if len(ends) > 2:  # it is not by the ports alone that each finds the other
        mapping = dict(profile.mapping)
        open_ends = {end.path: "" for end in ends if end.polarity == "required" and end.path not in mapping}
        options |= {f"mapping.{one}": other for one, other in {**mapping, **open_ends}.items()}
    return options
