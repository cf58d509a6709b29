"""The canonical form of entries in `Wanted`, whether they are read from a kernel or from a system file."""

from __future__ import annotations

import dataclasses
import enum
import inspect
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError, PluginError, SystemFileError
from aiorts.kernel.declarations import declarations
from aiorts.kernel.extensions.arguments import needs_rate, path_settings
from aiorts.kernel.extensions.type_texts import type_text
from aiorts.kernel.ports import InPort
from aiorts.kernel.service import KernelService, stand_in_reason
from aiorts.model.configuration.sets import DEFAULT, same
from aiorts.model.converter import Converter
from aiorts.model.names import names_kernel
from aiorts.model.options import AGAIN, chosen_options, said_options
from aiorts.model.policy import OnLinkLost, Subscription
from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry
from aiorts.model.wanted.restart_policy import Supervision

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.extensions.catalogue import Catalogue
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.model.configuration.sets import ConfigurationState
    from aiorts.model.profile import ConnectorProfile
    from aiorts.model.wanted.entries import Wanted
    from aiorts.services import ServicePort

_SHOWN: Final = 20
_MISSING: Final = object()


class Canon:
    """Brings the parts of one system into the canonical form.

    Args:
        catalogue: what plugins offer.
        notes: gets what no system file can say and is left out.
    """

    def __init__(self, catalogue: Catalogue, notes: list[str]) -> None:
        self.notes = notes
        self.faults: list[str] = []
        """The faults that keep a system file from being made."""
        self._catalogue = catalogue
        self._types: dict[Any, str] = {}
        self._unmakeable: dict[type, str] = {}
        self._joined: set[tuple[str, ...]] = set()

    def check(self) -> None:
        """Raise SystemFileError that names all faults, where there is one."""
        if self.faults:
            more = f"\nand {len(self.faults) - _SHOWN} more" if len(self.faults) > _SHOWN else ""
            raise SystemFileError("\n".join(self.faults[:_SHOWN]) + more)

    def named(self, thing: Any, kind: str) -> str:
        """The text that names a class or function; "" if no text does."""
        text = self._types.get(thing)
        if text is None:
            text = self._types[thing] = type_text(thing, self._catalogue, kind)
        return text

    def component(
        self,
        name: str,
        cls: type[Component],
        state: ConfigurationState,
        keys: Mapping[str, Any],
    ) -> ComponentEntry:
        """A component of this class with this configuration; `keys`: its declared keys (`ComponentEntry`)."""
        text = self.named(cls, "components")
        if cls not in self._unmakeable:
            self._unmakeable[cls] = _unmakeable(cls, text)
        if what := self._unmakeable[cls]:
            self.faults.append(f"{name}: {what}")
        declared = declarations(cls).configuration
        return ComponentEntry(
            name,
            text,
            self._params(name, state, declared),
            (),
            self._sets(name, state, declared),
            state.active if state.active != declared.active else "",
            **{key: value for key, value in keys.items() if not _is_usual(key, value, cls)},
        )

    def _params(self, name: str, state: ConfigurationState, declared: ConfigurationState) -> Mapping[str, Any]:
        found = {}
        for param, value in state.sets[DEFAULT].items():
            usual = declared.sets[DEFAULT].get(param, state.specs[param].default)
            if same(value, usual):
                continue
            if param not in declared.specs:
                self.notes.append(f"{name}.{param} = {value!r:.80}: the parameter was added at run time")
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
                self.notes.append(f"{name}: the set {set_name!r} of its class was removed, and is there again")
        return MappingProxyType(found)

    def _reads_back(self, name: str, param: str, value: Any, declared: ConfigurationState) -> bool:
        """Whether a value is the same again when it is read from a file."""
        try:
            again = declared.specs[param].check(_as_read(_plain(value)))
        except ConfigurationError as error:
            self.faults.append(f"{name}.{param}: its value would be refused: {error}")
            return False
        if not isinstance(value, Path) and not same(again, value):
            self.faults.append(f"{name}.{param} = {value!r:.80}: no text of TOML is read back as this value")
            return False
        return True

    def context_options(self, context: Context) -> Mapping[str, Any]:
        """The options in the table of a context, without kind, members and activate."""
        kind, name = type(context), context.name
        if self.named(kind, "contexts") != context.kind:
            what = f"no plugin offers {kind.__qualname__} as the kind of context {context.kind!r}"
            self.faults.append(f"{name}: {what}; declare it as an entry point aiorts.contexts")
        options = {}
        always = ("rate",) if needs_rate(kind) else ()
        for argument, parameter in inspect.signature(kind).parameters.items():
            value = getattr(context, argument, _MISSING)
            if argument == "name" or parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
                continue
            if value is _MISSING and parameter.default is parameter.empty:
                what = f"its {context.kind} context needs {argument}, and does not have it as an attribute"
                self.faults.append(f"{name}: {what}; keep self.{argument}")
            elif value is _MISSING:
                self.notes.append(f"{name}: {argument} of its {context.kind} context, which does not say it")
            elif argument in always or value != parameter.default:
                if value is None:
                    self.faults.append(f"{name}: {argument} = None cannot be written in TOML; give it a value")
                options[argument] = value
        return MappingProxyType(options)

    def connection(
        self, ports: tuple[str, str], profile: ConnectorProfile, usual_length: int | None, number: int
    ) -> ConnectionEntry:
        """A connector of data ports.

        Args:
            usual_length: the length that the in-port declares.
        """
        usual_name, again = f"{ports[0]}-{ports[1]}", ports in self._joined
        self._joined.add(ports)
        options = chosen_options(profile, usual_length)
        if options.get("on_link_lost") == OnLinkLost.WAIT and not any(map(names_kernel, ports)):
            options = said_options(profile, usual_length)
        if profile.on_link_lost is not None and options.get("subscription", Subscription.FLUSH) != Subscription.FLUSH:
            options.setdefault("push", str(profile.push))  # that of a link that says none is another
        if profile.name not in ("", usual_name) and not (again and profile.name.startswith(usual_name)):
            options = {"name": profile.name, **options}
        if again:
            options |= AGAIN
        converter = profile.convert
        if isinstance(converter, Converter):
            text = self.named(converter.function, "converters")
            if text:
                options["convert"] = text
            elif converter.of_text:
                options["convert"] = str(converter)
            else:
                what = f"its converter {converter} is in no file, and no plugin offers it"
                self.faults.append(f"{usual_name}: {what}; write it as a function at the top of a FILE.py")
        return ConnectionEntry(ports, MappingProxyType({**options, **profile.extra}), number)


def service_connection(
    name: str, pair: tuple[str, str], ports: Sequence[ServicePort], mapping: Iterable[tuple[str, str]], *, strict: bool
) -> ConnectionEntry:
    """A connector of service ports; `mapping` is each required interface with the provided one."""
    options: dict[str, Any] = {}
    if name not in ("", f"{pair[0]}-{pair[1]}"):
        options["name"] = name
    if not strict:
        options["strict"] = False
    ends = [end for port in ports for end in port.interfaces]
    if len(ends) > 2:  # it is not by the ports alone that each finds the other
        bound = dict(mapping)
        unbound = {end.path: "" for end in ends if end.polarity == "required" and end.path not in bound}
        options |= {f"mapping.{one}": other for one, other in {**bound, **unbound}.items()}
    return ConnectionEntry(pair, MappingProxyType(options))


def table(settings: type, given: Mapping[str, Any]) -> Mapping[str, Any]:
    """The table of a service with these settings."""
    usual = {one.name: one.default for one in dataclasses.fields(settings)}
    paths = path_settings(settings)
    found = {key: whole(Path(value)) if key in paths and value else _frozen(value) for key, value in given.items()}
    return MappingProxyType({key: value for key, value in found.items() if value != usual.get(key, _MISSING)})


def without_provenance(wanted: Wanted, catalogue: Catalogue) -> Wanted:
    """The system without the tables of services that say only where it came from."""

    def is_difference(name: str) -> bool:
        try:
            return not catalogue.find("services", name).load_class(KernelService).provenance
        except PluginError:
            return True  # of a service that is not installed here

    kept = {name: one for name, one in wanted.services.items() if is_difference(name)}
    return wanted if len(kept) == len(wanted.services) else dataclasses.replace(wanted, services=MappingProxyType(kept))


def without_isolation(wanted: Wanted) -> Wanted:
    """The system with all components in the process of their kernel."""
    here = {
        name: dataclasses.replace(one, isolation="", limits=MappingProxyType({})) if one.isolation else one
        for name, one in wanted.components.items()
    }
    return dataclasses.replace(wanted, components=MappingProxyType(here))


def as_it_stands(now: Wanted, wanted: Wanted, kernel: Microkernel) -> Wanted:
    """The wanted system, but components that a service has replaced (`stands_for`) stay as they are now."""
    there = [name for name in now.components if name in kernel.components]
    names = {name for name in there if stand_in_reason(kernel.services, name)}
    if not names:
        return wanted
    ports = [port for name in names for port in kernel.components[name].ports.values()]
    unread = {port.path for port in ports if isinstance(port, InPort)}
    words = "isolation", "limits", "supervision"
    components = {
        name: dataclasses.replace(one, **{word: getattr(now.components[name], word) for word in words})
        if name in names
        else one
        for name, one in wanted.components.items()
    }
    return dataclasses.replace(
        wanted,
        components=MappingProxyType(components),
        connections=tuple(one for one in wanted.connections if unread.isdisjoint(one.ports[1:])),
    )


def whole(path: Path) -> Path:
    """The path from the root."""
    return Path(os.path.abspath(path))


def _is_usual(key: str, value: Any, cls: type[Component]) -> bool:
    """Whether a key of a component has the value that it has by default."""
    if key == "supervision":
        return value is None or bool(value == Supervision())
    return key == "on_link_lost" and bool(value == cls.on_link_lost)


def _frozen(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _plain(value: Any) -> Any:
    """A parameter's value as a system file has it."""
    if value is None:
        return "none"
    if isinstance(value, Path):
        return whole(value)
    if isinstance(value, enum.Enum):
        return value.name
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    if isinstance(value, Mapping):
        return MappingProxyType({key: _plain(one) for key, one in value.items()})
    return value


def _as_read(plain: Any) -> Any:
    """The value that is read back from TOML for this one."""
    if isinstance(plain, tuple):
        return list(map(_as_read, plain))
    if isinstance(plain, Mapping):
        return {key: _as_read(one) for key, one in plain.items()}
    return str(plain) if isinstance(plain, Path) else plain


def _unmakeable(cls: type, text: str) -> str:
    """Why no system file can have a component of this class; "" if one can."""
    if not text:
        return f"its class {cls.__qualname__} is in no file, and no plugin offers it; write it at the top of a FILE.py"
    try:
        arguments = list(inspect.signature(cls).parameters.values())
    except (TypeError, ValueError):
        return ""
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    needed = ", ".join(one.name for one in arguments[1:] if one.default is one.empty and one.kind not in several)
    what = f"{cls.__qualname__} takes {needed}, which no system file gives; make parameters of it"
    return what if needed else ""
