"""Carries out a plan in a kernel: all of it, or nothing.

The table of `Application` has two functions for each class of step: one carries it out, the other undoes it. When a
step fails, the undoes of this step and of the steps before it run in reverse order. What a step takes out is parked and
not ended, so that its undo puts the same object back. Parked objects end only when all is over.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Container, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from aiorts.composites import parts_of
from aiorts.errors import StateError, WiringError, format_error
from aiorts.isolation import Isolation, RemoteComponent, exchange, hold_at, make_replacement, placed
from aiorts.kernel.component import Component
from aiorts.kernel.configuring import put
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.context import Context
from aiorts.kernel.execution.file_access import acting
from aiorts.kernel.execution.member import is_open
from aiorts.kernel.extensions.arguments import settings_of
from aiorts.kernel.extensions.loading import load_aside
from aiorts.kernel.extensions.type_names import extension_of
from aiorts.kernel.ports import InPort
from aiorts.kernel.ports.in_port import set_open
from aiorts.kernel.ports.port import host_of
from aiorts.kernel.service import owned_by
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.options import CHANGEABLE, connector_profile, without_identity
from aiorts.model.wanted.restart_policy import Supervision
from aiorts.model.wanted.steps import (
    Activate,
    AddRules,
    Change,
    Configure,
    Connect,
    Create,
    Disconnect,
    Isolate,
    Move,
    Reload,
    Remove,
    Renew,
    RenewContext,
    Retime,
    StartContext,
    Step,
    StopContext,
    Supervise,
)
from aiorts.planning.component_rows import put_in_force
from aiorts.planning.setting import Setting
from aiorts.planning.shown import shown_name
from aiorts.planning.snapshot import Snapshot
from aiorts.planning.switching import CompositesAside, switch, tops, without_components
from aiorts.reload import Trial, check_replaceable, code_of
from aiorts.rules import ConnectingRules
from aiorts.supervision import Patience, Supervising

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector
    from aiorts.model.wanted.entries import ComponentEntry, ConnectionEntry, ContextEntry, Wanted
    from aiorts.model.wanted.plan import Plan
    from aiorts.planning.planning import Planning

Carry = Callable[[Any], Awaitable[None]]
MakeContext = Callable[["ContextEntry"], Context]
_ACTIVE: Final = LifecycleState.ACTIVE
_PATIENCE: Final = 5.0
"""Seconds of the kernel's clock in which a component of another type must be in its place."""


class Application:
    """One plan that is carried out, and what is needed to take the plan back."""

    def __init__(self, planning: Planning, now: Wanted, wanted: Wanted, plan: Plan) -> None:
        self._planning = planning
        self._kernel = planning.kernel
        self._now = now
        self._wanted = wanted
        self.plan = plan
        self._types: dict[str, type[Component]] = {}
        self._begun: list[Step] = []
        self._before = Snapshot(planning)
        self._parked: dict[str, Component] = {}
        self._composites = CompositesAside(keeps=True)
        self._lost: set[str] = set()
        """Components that could not be made again."""
        names = {one.name: shown_name(self._kernel, one) for one in self._kernel.connectors.values()}
        self._shown = {name: shown for name, shown in names.items() if shown != name}
        """The names of connectors in plans, by their names in the kernel, where the two differ."""
        self._connectors: list[Connector] = []
        """The parked connectors, in order."""
        self._of_services: list[Connector] = []
        """The parked connectors of services: no step is about them, they come back with their ports."""
        self.ended: frozenset[str] = frozenset()
        """Once all steps are carried out: the components that they have taken out of all contexts."""
        self._trials: dict[str, Trial] = {}
        """The trials of components that are instances of another type now, by name."""
        self._held: set[Component] = set()
        self._replacements: dict[str, Component] = {}
        """The replacements of components that go into another process, by name."""
        self._isolated = frozenset(one.after.name for one in plan.steps if isinstance(one, Isolate))
        """The components that go into another process."""
        self._table: Final[Mapping[type[Step], tuple[Carry, Carry]]] = {
            Create: (self._create, self._end),
            Remove: (self._remove, self._bring_back),
            Configure: (self._configure, self._configure_back),
            Reload: (self._reload, self._reload_back),
            Isolate: (self._isolate, self._isolate),
            Supervise: (self._supervise, self._supervise),
            AddRules: (self._rule, self._rule),
            Connect: (self._connect, self._end_connector),
            Disconnect: (self._disconnect, self._connect_back),
            Change: (self._change, self._change),
            Renew: (self._renew, self._renew),
            StartContext: (partial(self._start, self._wanted, self._context), self._stop),
            StopContext: (self._stop, partial(self._start, self._now, self._stopped)),
            Retime: (self._retime, self._retime),
            RenewContext: (partial(self._renew_context, self._context), partial(self._renew_context, self._stopped)),
            Activate: (self._activate, self._activate_back),
            Move: (partial(self._move, self._activates), partial(self._move, self._was_active)),
        }
        """The functions that carry out a step and undo it; the undo gets the reverse step, also of a step half done."""

    # -- forth and back --------------------------------------------------------------------------------------------

    async def load(self) -> None:
        """Load all types, and check what can be checked, before anything is changed.

        Raises:
            PluginError, ConfigurationError, StateError: says what cannot be made.
        """
        kernel = self._kernel
        for component in kernel.components.values():
            entry = self._now.components.get(component.name)
            if entry is not None:
                self._types.setdefault(entry.type, getattr(type(component), "original", type(component)))
        for step in self.plan.steps:
            if isinstance(step, Create | Reload):
                entry = step.component if isinstance(step, Create) else step.after
                if entry.type not in self._types:
                    offered = extension_of(entry.type, kernel.plugins)
                    self._types[entry.type] = await load_aside(offered, kernel.clock, Component)
                _setting(entry).merged(declarations(self._types[entry.type]).configuration, entry.name)
            elif isinstance(step, StartContext | RenewContext):
                self._context(step.context if isinstance(step, StartContext) else step.after)
        try:
            for step in self.plan.steps:
                if isinstance(step, Isolate):
                    self._replacements[step.after.name] = await self._make_replacement(step)
        except BaseException:
            await self._end_replacements()
            raise

    async def forth(self) -> None:
        """Carry out all steps.

        Raises:
            BaseException: what a step raised; nothing is taken back yet.
        """
        rules = [
            one.start for name, one in self._wanted.components.items() if one.start and name not in self._now.components
        ]
        patience = Patience(self._kernel, rules)
        for step in self.plan.steps:
            self._kernel.check_open("apply")
            self._begun.append(step)
            async with patience.activating(*self._who_comes_up(step)):
                await self.carry_out(step)
        if rules:
            await self._kernel.service(Supervising).start_in_order(rules, patience)
        await self._let_go()
        self.ended = self._before.ended()

    async def carry_out(self, step: Step) -> None:
        """Carry out one step; an error is raised, and leaves the step partly done."""
        await self._table[type(step)][0](step)

    @property
    def new(self) -> list[str]:
        """The components that are made or replaced."""
        steps = self.plan.steps
        made = [one.component.name for one in steps if isinstance(one, Create)]
        return made + [one.after.name for one in steps if isinstance(one, Reload)]

    @property
    def failed_step(self) -> str:
        """The text of the step that was begun last."""
        return self._begun[-1].text if self._begun else "apply"

    async def back(self) -> list[str]:
        """Take back all steps begun, the last one first; texts of what is not as before, and why."""
        self._composites.keeps = False
        failed = []
        for step in reversed(self._begun):
            back = step.reverse()
            if isinstance(back, Move):
                back = without_components(back, self._lost)
            try:
                with acting(None):  # the files that are named again were not named by the client
                    await self._table[type(step)][1](back)
            except Exception as error:  # noqa: BLE001 - the rest is taken back all the same, and this is said
                failed.append(f"{back.text}: {format_error(error)}")
                if isinstance(back, Create):
                    self._lost.add(back.component.name)
        exchanged = {one.after.name for one in self._begun if isinstance(one, Isolate)}
        self._begun = []
        left = await self._before.restore(self._lost, exchanged)
        await self._let_go()
        return failed + left

    def release(self) -> None:
        """Let ports open and close as always: all components are in their places."""
        held, self._held = self._held, set()
        for component in held:
            cell(component).held_open = False
            if component in self._kernel.registry.parked:
                continue
            cell(component).retired = False
            takes = is_open(component)
            for port in component.ports.values():
                if isinstance(port, InPort):
                    set_open(port, takes)

    async def settle(self) -> None:
        """Make the result final: end all parked objects."""
        kernel = self._kernel
        connectors, self._connectors, self._of_services = [*self._connectors, *self._of_services], [], []
        with self._planning.services_wait():  # whose they were looks at what has become free
            kernel.connections.end_each(tuple(connectors))
        trials, self._trials = self._trials, {}
        for trial in trials.values():
            await trial.settle()
        parked, self._parked = self._parked, {}
        for component in reversed(tuple(parked.values())):
            await kernel.registry.end_parked(component)
        await self._composites.end()
        await self._end_replacements()

    # -- components ------------------------------------------------------------------------------------------------

    async def _create(self, step: Create) -> None:
        kernel, entry = self._kernel, step.component
        if entry.name not in kernel.components:
            component = await _setting(entry).create(kernel, self._class_of(entry), entry.name)
            self._supervise_as(component, entry)

    async def _end(self, step: Remove) -> None:
        name = step.component.name
        await self._kernel.service(Supervising).settle(name)
        if (component := self._kernel.components.get(name)) is not None:
            await self._kernel.remove(component)

    async def _remove(self, step: Remove) -> None:
        kernel, name = self._kernel, step.component.name
        await kernel.service(Supervising).settle(name)
        component = kernel.components.get(name)
        if component is None or not self._planning.parks(component):
            await self._end(step)
            return
        for port in component.ports.values():  # what is left are connectors of services, not of the plan
            for connector in port.connectors:
                self._set_aside(connector)
        kernel.registry.park(component)
        self._parked[name] = component

    async def _bring_back(self, step: Create) -> None:
        entry, registry = step.component, self._kernel.registry
        component = None if entry.name in self._kernel.components else self._parked.pop(entry.name, None)
        if component is None:
            await self._create(step)
            return
        registry.unpark(component)
        self._put_back()
        self._supervise_as(component, entry)

    async def _configure(self, step: Configure) -> None:
        component = self._component(step.after.name)
        await put(self._kernel, component, partial(_as_wanted, _setting(step.after), component))

    async def _configure_back(self, step: Configure) -> None:
        before = self._before.configuration(step.after.name)
        await put(self._kernel, self._component(step.after.name), lambda state: before or state)

    async def _reload(self, step: Reload) -> None:
        kernel, entry = self._kernel, step.after
        trial = Trial(kernel, _PATIENCE)
        try:
            old = self._component(entry.name)
            check_replaceable(old)
            edit = partial(_as_declared, _setting(entry), entry.name)
            await trial.prepare(old, code_of(self._types[entry.type]), edit)
            await trial.switch()
            if lost := trial.left_out():
                raise WiringError(f"{entry.name}: {entry.type} has no port for {', '.join(lost)}")
        except BaseException as error:
            await trial.take_back(error)
            raise
        trial.end_watch()
        self._trials[entry.name] = trial
        await self._supervise(step)

    async def _reload_back(self, step: Reload) -> None:
        if (trial := self._trials.pop(step.after.name, None)) is not None:
            await trial.take_back(StateError("the plan was taken back"))
        await self._supervise(step)

    async def _isolate(self, step: Isolate) -> None:
        name = step.after.name
        old = self._component(name)
        if isinstance(old, RemoteComponent) is bool(step.after.isolation):
            return
        new = self._replacements.pop(name, None) or await self._make_replacement(step)
        await exchange(self._kernel, old, new)
        self._held.discard(old)

    async def _make_replacement(self, step: Isolate) -> Component:
        """Make the instance for the component's place, and its process, while the component still runs."""
        limits = step.after.limits if step.after.isolation else None
        return await make_replacement(self._kernel, self._component(step.after.name), limits)

    async def _end_replacements(self) -> None:
        """End the replacements that came to no place."""
        made, self._replacements = self._replacements, {}
        for component in made.values():
            await self._kernel.registry.end_parked(component)

    async def _let_go(self) -> None:
        """Let go of the in-ports of components that went into another process: they open and close as always."""
        for name in self._isolated:
            if name in self._kernel.components:
                await hold_at(self._kernel.components[name], False)

    async def _rule(self, step: AddRules) -> None:
        self._kernel.service(ConnectingRules).change(step.after)

    async def _supervise(self, step: Supervise | Reload) -> None:
        self._supervise_as(self._component(step.after.name), step.after)

    def _supervise_as(self, component: Component, entry: ComponentEntry) -> None:
        put_in_force(self._kernel, entry)
        supervising = self._kernel.service(Supervising)
        policy, there = entry.supervision, supervising.supervised.get(entry.name)
        if policy is not None or there is not None:
            make = partial(_setting(entry).make, self._class_of(entry))
            supervising.supervise(component, policy or Supervision(), make)

    def _class_of(self, entry: ComponentEntry) -> type[Component]:
        cls = self._types[entry.type]
        return self._kernel.service(Isolation).stand_in(cls, entry.limits) if entry.isolation else cls

    def _component(self, name: str) -> Component:
        """The component of this name. StateError: it was removed, or could not be made again."""
        component = self._kernel.components.get(name)
        if component is None:
            raise StateError(f"{name}: is not there any more")
        return component

    # -- connectors ------------------------------------------------------------------------------------------------

    async def _connect(self, step: Connect) -> None:
        for connector in self._in_the_way(step.connection.ports):
            self._set_aside(connector)
        await self._make(step.name, step.connection)

    async def _connect_back(self, step: Connect) -> None:
        connections, paths = self._kernel.connections, step.connection.ports
        ports = {self._kernel.registry.port(path) for path in paths}
        named = [one for one in self._connectors if self._shown.get(one.name, one.name) == step.name]
        parked = [one for one in named if {one.out, one.in_} == ports]
        connections.end_each(self._in_the_way(paths))
        if parked:
            self._connectors.remove(parked[-1])
            connections.unpark(parked[-1])
        else:
            await self._make(step.name, step.connection)

    async def _make(self, name: str, connection: ConnectionEntry) -> None:
        """Make the connector that has this name in plans, unless it exists."""
        kernel, (one, two) = self._kernel, connection.ports
        if self._named(name) not in kernel.connectors and name not in kernel.service_connectors:
            made = await kernel.connect(one, two, **connection.options)
            if made.name != name:
                self._shown[made.name] = name

    def _named(self, name: str) -> str:
        """The kernel's name of the connector that has this name in plans."""
        there = self._kernel.connectors
        return next((here for here, shown in self._shown.items() if shown == name and here in there), name)

    def _in_the_way(self, paths: tuple[str, ...]) -> tuple[Any, ...]:
        """The connectors of services in the places where the wanted system has a connector of its own."""
        owned = owned_by(self._kernel.services)
        port: Any = self._kernel.find(paths[0]) if owned is not None else None
        connectors = getattr(port, "connectors", ())
        return tuple(one for one in connectors if owned is not None and one.profile.ports == paths and owned(one))

    def _set_aside(self, connector: Any) -> None:
        """Park a connector of a service, or end it where the kernel does not know it."""
        connections = self._kernel.connections
        there = connections.connectors.get(connector.name)
        if there is not None and there is connector:
            connections.park(there)
            self._of_services.append(there)
        else:
            connections.end_each((connector,))

    def _put_back(self) -> None:
        """Put back the connectors of services whose ports are both there again, and whose names are free."""
        connections, parked = self._kernel.connections, self._kernel.registry.parked
        for connector in tuple(self._of_services):
            owners = {host_of(connector.out), host_of(connector.in_)}
            if not owners & parked and connector.name not in connections.connectors:
                self._of_services.remove(connector)
                connections.unpark(connector)

    async def _disconnect(self, step: Disconnect) -> None:
        connections, name = self._kernel.connections, self._named(step.name)
        if (connector := connections.connectors.get(name)) is not None:
            connections.park(connector)
            self._connectors.append(connector)
        elif (service := connections.service_connectors.get(name)) is not None:
            connections.end(service)

    async def _end_connector(self, step: Disconnect) -> None:
        connections, name = self._kernel.connections, self._named(step.name)
        connector = connections.connectors.get(name) or connections.service_connectors.get(name)
        if connector is not None:
            connections.end(connector)
        self._put_back()

    async def _change(self, step: Change) -> None:
        connector = self._kernel.connectors.get(self._named(step.name))
        if connector is None:
            raise StateError(f"{step.name}: is not there any more")
        profile = _profile(connector, step.after)
        words = {
            word: getattr(profile, word)
            for word in CHANGEABLE
            if getattr(profile, word) != getattr(connector.profile, word)
        }
        if words:
            self._kernel.connections.change(connector, words)

    async def _renew(self, step: Renew) -> None:
        options = dict(step.after.options)
        if isinstance(options.get("convert"), str):
            from aiorts.kernel.extensions.converters import load_converter

            options["convert"] = await load_converter(options["convert"], self._kernel.plugins, self._kernel.clock)
        connections = self._kernel.connections
        connector = connections.connectors.get(self._named(step.name))
        if connector is not None and not (connector.in_.is_far or connector.out.is_far):
            connections.replace_options(connector, without_identity(options))
        else:
            # Both kernels agree on a new link: samples under way are counted, and whether they came is not known.
            connections.end(connections.service_connectors[step.name] if connector is None else connector)
            await self._make(step.name, replace(step.after, options=options))

    # -- contexts --------------------------------------------------------------------------------------------------

    def _context(self, entry: ContextEntry) -> Context:
        kind = self._kernel.plugins.find("contexts", entry.kind).load_class(Context)
        return settings_of(kind, {"name": entry.name, **entry.options})

    def _stopped(self, entry: ContextEntry) -> Context:
        """The context that was stopped, which starts again, or a new one where there was none."""
        return self._before.contexts.get(entry.name) or self._context(entry)

    def _running(self, name: str) -> Context:
        """The context of this name. StateError: it was stopped."""
        context = self._kernel.contexts.get(name)
        if context is None:
            raise StateError(f"{name}: was stopped meanwhile")
        return context

    async def _start(self, system: Wanted, make: MakeContext, step: StartContext) -> None:
        if step.context.name not in self._kernel.contexts:
            # The members join the context later on; where they run decides where the context runs.
            there = self._kernel.components
            members = [there[one] for one in system.contexts[step.context.name].members if one in there]
            await self._kernel.start(placed(make(step.context), members))

    async def _stop(self, step: StopContext) -> None:
        context = self._kernel.contexts.get(step.context.name)
        if context is not None:
            await context.stop()

    async def _retime(self, step: Retime) -> None:
        context: Any = self._running(step.after.name)
        await context.set_rate(step.after.options["rate"])

    async def _renew_context(self, make: MakeContext, step: RenewContext) -> None:
        kernel, name = self._kernel, step.after.name
        there = kernel.contexts.get(name)
        named = [kernel.components[one] for one in step.before.members if one in kernel.components]
        members = named if there is None else tops(there)
        active = set() if there is None else {one.name for one in there.members if there.state(one) is _ACTIVE}
        self._hold(members)
        made = make(step.after)
        if there is not None:
            await there.stop()
        await kernel.start(made, *members)
        again = [
            one for one in made.members if (one.name in active if active else self._before.was_active(name, one.name))
        ]
        if again:
            await made.activate(*again)

    async def _activate(self, step: Activate, names: Container[str] | None = None) -> None:
        context = self._running(step.context)
        state = LifecycleState.INACTIVE if step.after else _ACTIVE
        members = [one for one in context.members if context.state(one) is state]
        members = [one for one in members if names is None or one.name in names]
        if members:
            await (context.activate if step.after else context.deactivate)(*members)

    async def _activate_back(self, step: Activate) -> None:
        names = (one.name for one in self._running(step.context).members)
        await self._activate(step, {one for one in names if self._before.was_active(step.context, one) is step.after})

    def _who_comes_up(self, step: Step) -> list[str]:
        """The names of the components that this step may activate."""
        if isinstance(step, Activate):
            return [one.name for one in self._running(step.context).members] if step.after else []
        lines = step.after.contexts.values() if isinstance(step, Move) else ()
        there = self._kernel.components
        return [part.name for line in lines for name in line if name in there for part in parts_of(there[name])]

    async def _move(self, activates: Callable[[str, Any], bool], step: Move) -> None:
        kernel = self._kernel
        names = dict.fromkeys(
            name for places in (step.before, step.after) for line in places.contexts.values() for name in line
        )
        for places in (step.before, step.after):
            for composite in places.composites.values():
                names.update(dict.fromkeys(() if composite is None else (composite.name, *composite.members)))
        self._hold([kernel.components[name] for name in names if name in kernel.components])
        for name in self._isolated & names.keys():
            await hold_at(self._component(name), True)
        await switch(kernel, step.after, activates, self._composites)

    def _activates(self, context: str, component: Component) -> bool:
        """Whether a component that comes into a context is to be active there."""
        if component.name in self._isolated:
            return self._before.was_active_somewhere(component.name)
        return self._is_started(self._wanted, context, component)

    def _was_active(self, context: str, component: Component) -> bool:
        """Whether a component that comes back into a context was active there."""
        known = [one.name for one in parts_of(component) if one.name in self._now.components]
        if known:
            return any(self._before.was_active(context, name) for name in known)
        return self._is_started(self._now, context, component)

    def _is_started(self, system: Wanted, context: str, component: Component) -> bool:
        """Whether a context of this system activates the component, which has no rule of its own."""
        entry, rules = system.contexts.get(context), self._wanted.components.get(component.name)
        return entry is not None and entry.activate and (rules is None or rules.start is None)

    def _hold(self, components: list[Component]) -> None:
        """Keep open in-ports open while their components are in no context: unread samples stay unread."""
        for component in components:
            for one in parts_of(component):
                if one not in self._held and is_open(one):
                    cell(one).held_open = True
                    self._held.add(one)


def _setting(entry: ComponentEntry) -> Setting:
    return Setting(MappingProxyType(dict(entry.params)), entry.sets, entry.active or None)


def _as_wanted(setting: Setting, component: Component, state: ConfigurationState) -> ConfigurationState:
    """The configuration of the entry; parameters that were added at run time stay."""
    declared = declarations(type(component)).configuration
    base = declared
    for name, spec in state.specs.items():
        if name not in declared.specs:
            base = base.with_parameter(spec, component.name)
    added = {name: state.sets[DEFAULT][name] for name in state.specs if name not in declared.specs}
    active = setting.active or declared.active
    return base.merged({DEFAULT: {**added, **setting.params}, **setting.sets}, active, component.name)


def _as_declared(setting: Setting, name: str, declared: ConfigurationState) -> ConfigurationState:
    return setting.merged(declared, name)


def _profile(connector: Connector, entry: ConnectionEntry) -> Any:
    usual = connector.in_.length
    length = () if usual is None else (usual,)
    options = without_identity({**entry.options, "convert": None})
    profile, _ = connector_profile("", options, connector.name, entry.ports, *length)
    return profile
