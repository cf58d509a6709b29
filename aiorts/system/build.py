"""Makes the system of a system file in a kernel; types, parameters, contexts and options are all checked before.

Only what depends on ports is found out later, because a component may make its ports when it is created.
"""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

from aiorts.errors import AiortsError, ComponentError, ConfigurationError, PluginError, SystemFileError, WiringError
from aiorts.kernel.catalogue import Catalogue
from aiorts.kernel.component import Component
from aiorts.kernel.context import Context
from aiorts.kernel.kernel import Kernel
from aiorts.kernel.offers import offer_from
from aiorts.kernel.plugins import load_extension
from aiorts.kernel.ports import Port
from aiorts.model.lifecycle import LifeCycleState
from aiorts.model.options import connector_profile
from aiorts.system.load import component_type, parameters
from aiorts.system.values import ConnectionEntry, ContextEntry, SystemFile

__all__ = ("Blueprint", "build", "prepare")


@dataclass(frozen=True, slots=True)
class Blueprint:
    """A system file with everything loaded and checked that is needed to build it once."""

    system: SystemFile
    types: Mapping[str, type[Component]]
    params: Mapping[str, Mapping[str, Any]]
    contexts: Mapping[str, Context]


def prepare(system: SystemFile, catalogue: Catalogue | None = None) -> Blueprint:
    """Load the types and check all that can be checked before anything is created.

    Args:
        catalogue: where types come from; the default one and the file's plugin folders by default.

    Raises:
        SystemFileError, PluginError, ConfigurationError, WiringError: says where in the file, and what is wrong.
    """
    if catalogue is None:
        catalogue = Catalogue((*Catalogue.default().folders, *system.plugin_paths))
    offer_from(catalogue)
    types = {entry.name: component_type(system, entry, catalogue) for entry in system.components.values()}
    params = {entry.name: parameters(system, entry, types[entry.name]) for entry in system.components.values()}
    for connection in system.connections:
        _check_options(system, connection)
        _check_declared(system, connection, types)
    contexts = {entry.name: _context(system, entry, catalogue) for entry in system.contexts.values()}
    return Blueprint(system, types, params, contexts)


async def build(kernel: Kernel, system: SystemFile | Blueprint) -> None:
    """Create the components, connect them, start the contexts and activate their members.

    A component whose `on_activated` raises is in error, as it would be later on; the others go on.

    Raises:
        AiortsError: what `prepare` raises; a port does not exist or does not fit.
        BaseException: what `on_initialize` of a component raises, with the component's name as a note.
    """
    plan = prepare(system) if isinstance(system, SystemFile) else system
    for entry in plan.system.components.values():
        try:
            await kernel.create(plan.types[entry.name], entry.name, **plan.params[entry.name])
        except BaseException as error:
            error.add_note(entry.name)
            raise
    for connection in plan.system.connections:
        ports = [_port(plan.system, kernel, connection, path) for path in connection.ports]
        try:
            await kernel.connect(*ports, **connection.options)
        except WiringError as error:
            raise WiringError(f"{plan.system.path}: {connection.place}: {error}") from None
    for context in plan.system.contexts.values():
        members = [kernel.components[name] for name in context.members]
        await kernel.start(plan.contexts[context.name], *members)
    for name in _readers_first(plan.system):
        for context in plan.system.contexts.values():
            if context.activate and name in context.members:
                await _activate(plan.contexts[context.name], kernel.components[name])


async def _activate(context: Context, component: Component) -> None:
    if context.state(component) is LifeCycleState.ERROR:
        return  # on_startup failed, which is logged and on the bus: its own affair, as below
    with contextlib.suppress(ComponentError):
        await context.activate(component)


def _readers_first(system: SystemFile) -> list[str]:
    """The components, each after those it sends to, so that the first sample of a source finds its reader active.

    Where data goes round in a circle the order of the file decides.
    """
    readers: dict[str, list[str]] = {name: [] for name in system.components}
    for connection in system.connections:
        writer, *others = (path.partition(".")[0] for path in connection.ports)
        readers[writer] += others
    ordered: dict[str, None] = {}
    for root in system.components:
        seen, stack = {root}, [(root, iter(readers[root]))]
        while stack:
            name, rest = stack[-1]
            following = next((one for one in rest if one not in seen and one not in ordered), None)
            if following is None:
                stack.pop()
                ordered.setdefault(name)
            else:
                seen.add(following)
                stack.append((following, iter(readers[following])))
    return list(ordered)


def _port(system: SystemFile, kernel: Kernel, connection: ConnectionEntry, path: str) -> Port[Any]:
    try:
        found = kernel.find(path)
    except AiortsError as error:
        component, _, name = path.partition(".")
        near = get_close_matches(name, kernel.components[component].ports, n=1)
        hint = f"; did you mean {component}.{near[0]}?" if near else ""
        raise SystemFileError(f"{system.path}: {connection.place}: {error}{hint}") from None
    assert isinstance(found, Port)  # noqa: S101 - the parser has seen that the path names one
    return found


def _check_options(system: SystemFile, connection: ConnectionEntry) -> None:
    try:
        connector_profile(connection.place, connection.options, "", connection.ports)
    except WiringError as error:
        raise WiringError(f"{system.path}: {error}") from None


def _check_declared(system: SystemFile, connection: ConnectionEntry, types: Mapping[str, type[Component]]) -> None:
    """Refuse a port that its class does not declare, unless the class may make ports itself."""
    for path in connection.ports:
        component, _, name = path.partition(".")
        cls = types[component]
        declared = [port.name or attribute for attribute, port in cls._rt_port_declarations.items()]
        if name in declared or not declared:
            continue
        near = get_close_matches(name, declared, n=1)
        if near:
            raise SystemFileError(
                f"{system.path}: {connection.place}: {component} has no port {name!r}; did you mean {near[0]!r}?"
            )


def _context(system: SystemFile, entry: ContextEntry, catalogue: Catalogue) -> Context:
    where = f"{system.path}: contexts.{entry.name}"
    cls = _context_class(where, entry.kind, catalogue)
    signature = inspect.signature(cls)
    for key in entry.options:
        if key == "name" or key not in signature.parameters:
            known = [name for name in signature.parameters if name != "name"] + ["kind", "members", "activate"]
            near = get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"a {entry.kind} context takes {', '.join(known)}"
            raise SystemFileError(f"{where}: unknown key {key!r}; {hint}")
    try:
        context = cls(name=entry.name, **entry.options)
    except (ConfigurationError, TypeError) as error:
        raise ConfigurationError(f"{where}: {error}") from None
    return context


def _context_class(where: str, kind: str, catalogue: Catalogue) -> type[Context]:
    offers = list(catalogue.extensions("contexts"))
    if kind not in offers:
        near = get_close_matches(kind, offers, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"there are {', '.join(offers)}"
        raise SystemFileError(f"{where}.kind: unknown kind {kind[:80]!r}; {hint}")
    found = load_extension("contexts", kind, catalogue)
    if not (isinstance(found, type) and issubclass(found, Context)):
        raise PluginError(f"{where}.kind: {kind} is no execution context")
    return found
