"""Makes the system of a system file in a kernel; types, parameters, contexts and options are all checked before.

Only faults that depend on ports are found later, because a component may make its ports when it is created.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from functools import partial
from types import MappingProxyType
from typing import Any

from aiorts.assembly import Kernel
from aiorts.composites import Composite
from aiorts.errors import AiortsError, ComponentError, PluginError, StateError, SystemFileError, WiringError
from aiorts.isolation import Isolation
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import flattened
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.kernel.ports import Port
from aiorts.kernel.service import ServicePlan, attach_services
from aiorts.late import dataclass
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.names import names_kernel
from aiorts.model.wanted.entries import CompositeEntry, ConnectionEntry, said_keys
from aiorts.planning import Planning, Setting, put_in_force
from aiorts.spelling import meant
from aiorts.supervision import Patience, Supervising, in_order
from aiorts.system.checks.adapting import adapted
from aiorts.system.checks.check import of_draft
from aiorts.system.checks.connection_checks import end_key
from aiorts.system.file.families import activation_order, inner_first, unstartable
from aiorts.system.file.parse import spelled
from aiorts.system.file.survey import Fault, Survey, survey
from aiorts.system.file.values import SystemFile
from aiorts.system.text.places import Key


@dataclass(frozen=True, slots=True)
class Blueprint:
    """A system file with its types, settings and services loaded and checked; it can be built once."""

    system: SystemFile
    types: Mapping[str, type[Component]]
    settings: Mapping[str, Setting]
    contexts: Mapping[str, Context]
    catalogue: Catalogue
    services: Mapping[str, ServicePlan]
    converters: Mapping[int, str]
    """The converters by the number of their connection."""

    @property
    def params(self) -> Mapping[str, Mapping[str, Any]]:
        """The values of each component's set "default" that differ from the declared ones."""
        return {name: setting.params for name, setting in self.settings.items()}


def prepare(
    system: SystemFile,
    catalogue: Catalogue | None = None,
    services: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Blueprint:
    """Load the types and check all that can be checked before anything is created.

    Args:
        catalogue: the source of types; the default catalogue and the file's plugin folders by default.
        services: settings by the name of a service; they win over those of its table in the file, which may be missing.

    Raises:
        SystemFileError, PluginError, ConfigurationError, WiringError: the file has a fault; names its place.
    """
    found = survey(system, catalogue, services)
    _check_declared(found)
    for key, text in unstartable(system):
        found.say(key, SystemFileError(text), spelled(system.origins.known(key)) if system.text else "")
    if not found.faults:
        adapted(found)
    if found.faults:
        raise _refused(system, found.faults[0]) from found.faults[0].error.__cause__
    system = found.system
    converters = {number: one.convert for number, (one, _) in found.profiles.items() if one.convert is not None}
    return Blueprint(system, found.types, found.settings, found.contexts, found.catalogue, found.services, converters)


def _refused(system: SystemFile, fault: Fault) -> AiortsError:
    """The error to raise for a fault: with its place in the file, and the line to quote."""
    if fault.where.startswith("--") or not system.text:
        where = fault.where if fault.where.startswith("--") else f"{system.path}: {fault.where}"
        return type(fault.error)(f"{where}: {fault.error}").like(fault.error)
    where = f"{system.at(*fault.key, of_key=fault.of_key)}: {fault.where}"
    error = type(fault.error)(f"{where}: {fault.error}").like(fault.error)
    if error.typed is None and not isinstance(error, PluginError):  # else the fault is in another file
        system.origins.spot(fault.key, of_key=fault.of_key).mark(error)
    return error


async def build(kernel: Kernel, system: SystemFile | Blueprint) -> None:
    """Attach the services, create the components, connect them, start the contexts and activate their members.

    The kernel keeps the catalogue of the file's plugin folders, for components that are made later by name.

    A component whose `on_activated` raises is in error, as it would be later on; the others go on.

    Raises:
        AiortsError: an error of `prepare`.
        WiringError: a port does not exist, or does not fit the port it is connected with.
        BaseException: an error of a component's `on_initialize`, with the component's name as a note.
    """
    plan = prepare(system) if isinstance(system, SystemFile) else system
    folders = (*kernel.plugins.folders, *plan.catalogue.folders)
    kernel.plugins = Catalogue(dict.fromkeys(folders)) if kernel.plugins.folders else plan.catalogue
    system = plan.system
    kernel.origin, kernel.registry.assembled = system.text, False
    planning = kernel.service(Planning)
    planning.clock = system.clock
    attach_services(kernel, plan.services.values())
    for entry in system.components.values():
        put_in_force(kernel, entry)
    with contextlib.ExitStack() as making:
        for attached in kernel.services:
            making.enter_context(attached.making())
        await _make(kernel, plan)
    for attached in kernel.services:
        await attached.starting()
    await _start(kernel, plan)
    for attached in kernel.services:
        attached.started()
    kernel.registry.mark_assembled()


async def _make(kernel: Kernel, plan: Blueprint) -> None:
    """Create the components and connect them."""
    system = plan.system
    for name in system.components:
        try:
            await _create(kernel, plan, name)
        except AiortsError as error:
            error.add_note(_place_of(system, name, error))
            raise
        except BaseException as error:
            error.add_note(name)
            raise
    for composite in inner_first(system.composites):
        await _compose(kernel, system, composite)
    _check_members(kernel, plan)
    for connection in system.connections:
        ports = [_port(system, kernel, connection, number) for number in range(len(connection.ports))]
        try:
            await kernel.connect(*ports, **_options(plan, connection))
        except WiringError as error:
            where = system.at(*_blamed(connection, str(error)))
            raise WiringError(f"{where}: {connection.place}: {error}") from None


async def _start(kernel: Kernel, plan: Blueprint) -> None:
    """Start the contexts and activate their members."""
    system, started = plan.system, {}
    for context in system.contexts.values():
        members = [kernel.components[name] for name in context.members]
        started[context.name] = await kernel.start(plan.contexts[context.name], *members)
    rules = [entry.start for entry in system.components.values() if entry.start is not None]
    patience = Patience(kernel, rules)
    for name in activation_order(system):
        entry = system.components.get(name)
        for context in system.contexts.values():
            if context.activate and name in context.members and (entry is None or entry.start is None):
                component = kernel.components[name]
                async with patience.activating(name, *(part.name for part in flattened((component,)))):
                    await _activate(started[context.name], component)
    for rule in in_order(rules):
        # A component that fails is in error; a rule that waits for it reports that, unless it recovers in time.
        with contextlib.suppress(ComponentError):
            await kernel.service(Supervising).start_in_order([rule], patience)


def _options(plan: Blueprint, connection: ConnectionEntry) -> Mapping[str, Any]:
    """The options of a connection, with the converter that was loaded for its text."""
    converter = plan.converters.get(connection.number)
    return connection.options if converter is None else {**connection.options, "convert": converter}


async def _create(kernel: Kernel, plan: Blueprint, name: str) -> None:
    """Create a component; its configuration is set before its first hook runs, its supervision before it can fail."""
    cls, setting, entry = plan.types[name], plan.settings[name], plan.system.components[name]
    for service in kernel.services:
        if (other := service.in_place_of(name, cls, partial(setting.make, cls, name))) is not None:
            await setting.create(kernel, other, name)
            return
    if entry.isolation:
        cls = kernel.service(Isolation).stand_in(cls, entry.limits)
    component = await setting.create(kernel, cls, name)
    policy = entry.supervision
    if policy is not None:
        kernel.supervise(component, policy, factory=partial(setting.make, cls))


async def _compose(kernel: Kernel, system: SystemFile, entry: CompositeEntry) -> None:
    key = ("composites", entry.name)
    try:
        await kernel.add(Composite(entry.name, *entry.members, **said_keys(entry)))
    except AiortsError as error:
        text = str(error).removeprefix(f"{entry.name}: ")
        raise SystemFileError(f"{system.at(*key)}: {spelled(key)}: {text}") from error


def _check_members(kernel: Kernel, plan: Blueprint) -> None:
    """Refuse members that their context cannot run, as a fault of the file, before any context runs."""
    for entry in plan.system.contexts.values():
        for name in entry.members:
            try:
                for part in flattened((kernel.components[name],)):
                    plan.contexts[entry.name].runner.check_can_add(part)
            except StateError as error:
                key = ("contexts", entry.name, "members")
                raise SystemFileError(f"{plan.system.at(*key)}: {spelled(key)}: {error}") from error


async def _activate(context: Context, component: Component) -> None:
    if component.states.get(context.name) is LifecycleState.ERROR:
        return  # on_startup failed, which is logged and on the bus; the others go on, as below
    with contextlib.suppress(ComponentError):
        if isinstance(component, Composite):
            await component.activate()  # the whole composite or nothing, according to its errors = "..."
        else:
            await context.activate(component)


def _port(system: SystemFile, kernel: Kernel, connection: ConnectionEntry, number: int) -> Port[Any] | str:
    path = connection.ports[number]
    if names_kernel(path):
        return path
    try:
        found = kernel.find(path)
    except AiortsError as error:
        component, _, name = path.partition(".")
        hint = meant(name, kernel.components[component].ports, lambda near: f"{component}.{near}")
        where = system.at(*end_key(connection, number))
        raise SystemFileError(f"{where}: {connection.place}: {error}{hint}") from None
    assert isinstance(found, Port)  # noqa: S101 - the parser has seen that the path names one
    return found


def _place_of(system: SystemFile, name: str, error: AiortsError) -> str:
    """The name of a component that could not be made, with the place of its entry in the file."""
    if not system.text:
        return name
    said = of_draft(system, name, error)
    return f"{said.spot or system.origins.spot(said.key)}: {name}"


def _blamed(connection: ConnectionEntry, why: str) -> Key:
    """The place of the in-port that an error is about: the first one that the message names, else the first of all."""
    named = (number for number, path in enumerate(connection.ports) if number and f"{path}:" in why)
    return end_key(connection, next(named, 1))


def _check_declared(found: Survey) -> None:
    """Refuse a port that its class does not declare, unless the class may make ports itself."""
    for connection in found.system.connections:
        for number, path in enumerate(connection.ports):
            component, _, name = path.partition(".")
            cls = found.types.get(component)
            if cls is None or cls.ports_for is not Component.ports_for or hasattr(cls, "make_ports"):
                continue
            declared = [port.name or attribute for attribute, port in declarations(cls).ports.items()]
            if name not in declared and (hint := meant(name, declared)):
                what = f"{component} has no port {name!r}{hint}"
                found.say(end_key(connection, number), SystemFileError(what), connection.place)
