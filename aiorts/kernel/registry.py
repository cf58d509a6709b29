"""The components of one kernel: how they come in, what they leave behind, how they go; never two at once for one.

Coming in is all or nothing. Going is a task of the kernel's own, so that the caller may be cancelled, be a hook of the
component itself, or ask twice.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.errors import ComponentError, DeclarationError, InvalidNameError, StateError, WiringError, format_error
from aiorts.kernel import embedding
from aiorts.kernel.component import Component, construct
from aiorts.kernel.configuring import put_parameters
from aiorts.kernel.declarations import kinds_of
from aiorts.kernel.detached_hook import run_alone
from aiorts.kernel.execution.cell import as_group, cell, has_cell
from aiorts.kernel.extensions.loading import load_aside
from aiorts.kernel.leaks import report_leaks
from aiorts.kernel.loop.bus import Assembled, ComponentAdded, ComponentRemoved, HookFailed, PortAdded, PortRemoved
from aiorts.kernel.loop.deadlines import CANCELLATIONS, StopBudget
from aiorts.kernel.loop.exceptions import chain, note, presentable
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.loop.origins import located, origin_of
from aiorts.kernel.loop.tasks import abandon_task, current_task, kernel_task, owner_of
from aiorts.kernel.ports import Port
from aiorts.kernel.ports.port import vacate, wake_waiter
from aiorts.kernel.ports.receiver import EndingError
from aiorts.kernel.service import notify
from aiorts.model.lifecycle import HOOKS
from aiorts.model.names import Path
from aiorts.model.ordering import arrange
from aiorts.spelling import suggestion

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import Cell
    from aiorts.kernel.microkernel import Microkernel

C = TypeVar("C", bound=Component)
_NAMED: Final = 10
"""Instances that a message lists."""
_LOG = KernelLog()


class Registry:
    """The components of a kernel, by name, in the order they came."""

    def __init__(self, kernel: Microkernel) -> None:
        self._kernel = kernel
        self.components: dict[str, Component] = {}
        self._kinds: Counter[type[Component]] = Counter()
        """How many there are of each type."""
        self.tasks: dict[Component, set[asyncio.Task[Any]]] = {}
        """Tasks that components started and that have not ended."""
        self._arriving: dict[Component, asyncio.Future[None]] = {}
        self._cells: dict[str, Cell] = {}
        """The cell of each component, by its name: the component may lose it, since it can clear its `__dict__`."""
        self._leaving: dict[Component, asyncio.Task[BaseException | None]] = {}
        self.renewing: set[asyncio.Task[Any]] = set()
        """Reloads that have not come to their end."""
        self.renewal = asyncio.Lock()
        """Held by the one whose turn it is."""
        self.taken_back: set[Component] = set()
        """Instances whose code was taken back, and that stay in their place until a hook of theirs returns."""
        self.parked: set[Component] = set()
        """The components that are out of their places, and may come back."""
        self.on_link_lost: dict[str, str] = {}
        """By the component's name: what a system file says of it where its class may say otherwise; "" is nothing."""
        self.assembled: bool | None = None
        """Whether all that the run was to begin with is there; None: the program that makes it does not say."""
        self.lasting = ""
        """The name by which clients know the kernel again after a restart, as its profile has it."""
        self.runs = ""
        """The path of the system file that runs, from the setting `runs` of control; "" where it is not known."""
        self.composing = asyncio.Lock()
        """Held while a composite changes: one at a time."""

    def find(self, path: str) -> Component | Port[Any]:
        """See `Kernel.find`."""
        where = Path.parse(path)
        if where.kernel:
            self._check_here(path, where)
        component = self.components.get(where.component)
        if component is None:
            there = suggestion(where.component, self.components)
            raise WiringError(f"{path}: no component {where.component!r}; {there}")
        if not where.port:
            return component
        port = component.ports.get(where.port)
        if port is None:
            has = suggestion(where.port, component.ports, f"it has {', '.join(component.ports) or 'none'}")
            raise WiringError(f"{path}: {where.component} has no port {where.port!r}; {has}")
        return port

    def port(self, path: str) -> Port[Any]:
        """The port of a path. WiringError: there is none, or it is the path of a component."""
        found = self.find(path)
        if isinstance(found, Port):
            return found
        ports = ", ".join(f"{path}.{name}" for name in found.ports)
        raise WiringError(f"{path}: is a component; {f'give one of its ports: {ports}' if ports else 'it has no port'}")

    def is_elsewhere(self, path: str) -> bool:
        """Whether a path means another kernel than this, which has its own name and that of its address."""
        if "/" not in path:
            return False
        import platform  # late: as below

        where, kernel = Path.parse(path), self._kernel
        if where.kernel not in (kernel.name, kernel.address.rpartition("/")[2]):
            return True
        return where.host.lower() not in ("", "localhost", platform.node().lower())

    def _check_here(self, path: str, where: Path) -> None:
        """Raise WiringError when a path that names its kernel, or its host too, means another one than this."""
        import platform  # late: 1.5 ms that few kernels need

        here, rest = platform.node(), str(replace(where, kernel="", host=""))
        if where.host and where.host.lower() not in ("localhost", here.lower()):
            raise WiringError(f"{path}: is on the host {where.host!r}, and this is {here!r}; ask a kernel there")
        if where.kernel != self._kernel.name:
            raise WiringError(
                f"{path}: is in the kernel {where.kernel!r}, and this is {self._kernel.name!r}; "
                f"ask that kernel, or for {rest!r} here"
            )

    # -- coming in -------------------------------------------------------------------------------------------------

    async def create(self, kind: type[Component] | str, name: str, params: Mapping[str, object]) -> Component:
        """Make a component of a class, or of a type as text, and take it in."""
        if isinstance(kind, str):
            from aiorts.kernel.extensions.type_names import extension_of  # late: a class is the usual case

            offered = extension_of(kind, self._kernel.plugins)
            cls: type[Component] = await load_aside(offered, self._kernel.clock, Component)
            self._kernel.check_open("create")  # it may have closed meanwhile
        else:
            cls = kind
        if not (isinstance(cls, type) and issubclass(cls, Component)):
            raise DeclarationError(f"{cls!r}: expected a class derived from Component")
        component = construct(cls, name)
        if name == "" and not cell(component).named:
            cell(component).rename(self._kernel._instance_name(cls))
        return await self.add(component, params)

    async def add(self, component: C, params: Mapping[str, object]) -> C:
        """Take a component in; if its `on_initialize` fails, as if it had never been there."""
        kernel = self._kernel
        self._check_class(component)
        if not cell(component).named:
            cell(component).rename(kernel._instance_name(type(component)))
        self._check_free(component)
        put_parameters(component, params)
        cell(component).kernel = kernel
        self.components[component.name] = component
        self._count(type(component), 1)
        arrived = self._arriving[component] = kernel.loop.create_future()
        try:
            if (group := as_group(component)) is not None:
                await group.added()
            self._cells[component.name] = cell(component)
            await self._initialize(component)
        except BaseException:
            self._forget(component)
            raise
        finally:
            del self._arriving[component]
            arrived.set_result(None)
        self._announce(component)
        return component

    def _announce(self, component: Component) -> None:
        bus = self._kernel.bus
        for name, port in component.ports.items():
            profile = port.profile if port.name == name else replace(port.profile, name=name)
            bus.publish(PortAdded(component.name, profile))
        bus.publish(ComponentAdded(component.name))
        notify(self._kernel.services, "component_added", component)

    def mark_assembled(self) -> None:
        """Set `assembled`, and publish it, once: all that the run was to begin with is there."""
        if not self.assembled:
            self.assembled = True
            self._kernel.bus.publish(Assembled())

    def _announce_end(self, component: Component) -> None:
        self.on_link_lost.pop(component.name, None)
        self._kernel.bus.publish(ComponentRemoved(component.name))
        notify(self._kernel.services, "component_removed", component)

    def is_arriving(self, component: Component) -> bool:
        """Whether its `on_initialize` runs: it may yet fail, and then it was never there."""
        return component in self._arriving

    def is_leaving(self, component: Component) -> bool:
        """Whether it is being removed."""
        return component in self._leaving

    def leave_instead(self, component: Component, other: Component) -> None:
        """If `other` is being removed, so is this one from now on, which gets its place back."""
        task = self._leaving.get(other)
        if task is not None:
            self._leaving[component] = task
            task.add_done_callback(lambda _: self._leaving.pop(component, None))

    def replace(self, old: Component, new: Component) -> None:
        """Put a new instance in the place of an old one, which keeps its number in the order, and notify the services.

        Between two cycles; the caller has given it what belongs to the place: ports, contexts, parameters.
        """
        self.components[new.name] = new
        self._count(type(new), 1)
        self._count(type(old), -1)
        notify(self._kernel.services, "components_replaced", {old: new})

    def kept_cell(self, component: Component) -> Cell | None:
        """The cell of a component of this kernel; None when it is not of this kernel."""
        return next((self._cells.get(name) for name, one in self.components.items() if one is component), None)

    def _check_class(self, component: Component) -> None:
        if not isinstance(component, Component):
            raise DeclarationError(f"{component!r}: expected a Component instance, got {type(component).__name__}")
        kind = type(component).__name__
        if not has_cell(component):
            raise DeclarationError(f"{kind}: super().__init__(name) was not called in its __init__")
        shadowed = [hook for hook in HOOKS if hook in vars(component)]
        if shadowed:
            raise DeclarationError(f"{kind}.{shadowed[0]}: set on the instance; hooks are written in the class")
        if (kernel := cell(component).kernel) is not None:
            raise StateError(f"{component.name}: belongs to {kernel.name} already, or did; a component is added once")

    def _check_free(self, component: Component) -> None:
        name, kind = component.name, type(component)
        if name in self.components:
            raise InvalidNameError(f"{name}: there is a component of that name already; choose another")
        limit = kind.max_instance
        if limit is not None:
            count = self._kinds[kind]
            if count >= limit:
                there = [one for one, other in self.components.items() if type(other) is kind]
                names = ", ".join(there[:_NAMED]) + (", ..." if len(there) > _NAMED else "")
                raise StateError(f"{name}: {kind.__name__} allows {limit} instances, {count} exist: {names}")

    def check_settled(self, component: Component) -> None:
        """Raise StateError while the component comes in or goes: no context may run it then."""
        if component in self._arriving:
            raise StateError(f"{component.name}: its on_initialize still runs; start it once it was added")
        if component in self._leaving:
            raise StateError(f"{component.name}: is being removed; no context can take it")
        if self.components.get(component.name) is not component:
            raise StateError(f"{component.name}: another instance has its place; take kernel.components[...]")

    # -- out of its place and back -----------------------------------------------------------------------------------

    def park(self, component: Component) -> None:
        """Take a component out, which is in no context, and keep it whole until `unpark` or `end_parked`; no hook runs.

        Its connectors are parked, or ended, already. No group is parked: its members are.
        """
        del self.components[component.name]
        self._cells.pop(component.name, None)
        self._leave_out(component)
        self.parked.add(component)
        self._announce_end(component)

    def unpark(self, component: Component) -> None:
        """Put a parked component back; nothing of it has changed. StateError, InvalidNameError: its place is taken."""
        self._check_free(component)
        self.parked.discard(component)
        self.components[component.name] = component
        self._cells[component.name] = cell(component)
        self._count(type(component), 1)
        self._announce(component)

    async def end_parked(self, component: Component) -> None:
        """The end of a parked component: its `on_finalize`, and what it started is ended."""
        if component in self.parked:
            self.parked.discard(component)
            await self._finalize(component, StopBudget(self._kernel.loop))

    def arrange(self, names: Iterable[str]) -> None:
        """Put the components of these names in this order; others come behind them."""
        arrange(self.components, names)

    def supersede(self, old: Component, new: Component) -> None:
        """Put a new instance, whose `on_initialize` has run, in the place of an old one, which is parked."""
        self.replace(old, new)
        self._cells[new.name] = cell(new)
        self.parked.discard(new)
        self.parked.add(old)

    def stranger(self, component: object, name: str, where: str) -> str:
        """The text of an error about a component of another kernel, or whose place another instance has."""
        if (
            name in self.components
            and isinstance(component, Component)
            and has_cell(component)
            and cell(component).kernel is self._kernel
        ):
            return f"{name}: another instance has its place; take kernel.components[{name!r}]"
        return f"{name}: does not belong to {where}; await kernel.add(...) first"

    async def _initialize(self, component: Component) -> None:
        error = await run_alone(self._kernel, component, "on_initialize", None, limit=self._kernel.initialize_timeout)
        if error is None:
            return
        self._kernel.bus.publish(
            HookFailed(component.name, "", "on_initialize", error, origin_of(error, installed=True))
        )
        kind = type(error)
        if issubclass(kind, KeyboardInterrupt):
            self._kernel.pass_on_interrupt(error)
        ordinary = issubclass(kind, Exception) and not issubclass(kind, StopIteration | StopAsyncIteration)
        if ordinary and presentable(error) is error:
            raise error
        # A CancelledError or SystemExit of the component must not pass for one of the caller's; and what raises when it
        # is looked at is told, not handed on.
        refused = ComponentError(f"{component.name}: on_initialize raised {located(error)}; it was not created")
        raise refused from presentable(error)

    # -- going -----------------------------------------------------------------------------------------------------

    async def remove(self, component: Component) -> None:
        """Remove a component; at the request of a hook that this would wait for, soon after that hook."""
        if component in self._arriving:
            raise StateError(f"{component.name}: cannot be removed while its on_initialize runs")
        task = self._leaving.get(component)
        cell(component).removals += 1
        if task is None:
            task = kernel_task(self._kernel.loop, self._leave(component), f"aiorts remove {component.name}")
            self._leaving[component] = task
            task.add_done_callback(lambda _: self._leaving.pop(component, None))
        if owner_of(current_task()) is component or any(context.runner.inside() for context in component.contexts):
            task.add_done_callback(_log_error)
            return
        error = await asyncio.shield(task)
        if error is not None:
            raise error

    async def _leave(self, component: Component) -> BaseException | None:
        self.vacate(component)
        if (group := as_group(component)) is not None:
            try:
                await group.dissolve()
            except (TimeoutError, RuntimeError) as error:
                return error
        # Its code may be taken back meanwhile: then it is the old instance that goes.
        while cell(component := cell(component).successor or component).members:
            context = component.contexts[0]
            try:
                await context.runner.release((component,))
            except (TimeoutError, RuntimeError) as error:
                # One that stopped meanwhile has let go of it.
                if context in component.contexts:
                    self.vacate(component, leaving=False)
                    return error
        await self._finalize(component, StopBudget(self._kernel.loop))
        return None

    def vacate(self, component: Component, *, leaving: bool = True) -> None:
        """It is about to go (or stays after all): calls that it serves end, and no other begins."""
        for port in component.ports.values():
            vacate(port, leaving)

    async def close(self, budget: StopBudget) -> None:
        """Remove all components, in reverse order; contexts have stopped and none is added any more."""
        while self._arriving or self._leaving or self.renewing:
            coming_and_going: list[asyncio.Future[Any]] = [
                *self._arriving.values(),
                *self._leaving.values(),
                *self.renewing,
            ]
            await asyncio.wait(coming_and_going)
            await asyncio.sleep(0)
        embedding.settle(self._kernel, self._kernel.loop)
        for component in reversed(tuple(self.components.values())):
            await self.through(self._finalize(component, budget))
        await self.end_tasks([task for tasks in self.tasks.values() for task in tasks], budget)
        embedding.settle(self._kernel, self._kernel.loop)

    async def through(self, step: Awaitable[None]) -> None:
        """One step of the kernel's end: whatever is wrong with it, the next follows."""
        try:
            await step
        except Exception as fault:  # noqa: BLE001 - of the kernel's own: all else is ended all the same
            self._kernel._faulted()
            text = "%s: a fault of aiorts itself while it closed; please report it"
            _LOG.error(text, self._kernel.name, exc_info=fault)

    async def _finalize(self, component: Component, budget: StopBudget) -> None:
        kernel = self._kernel
        self._disconnect(component)
        error = None
        if cell(component).abandoned is None:
            error = await run_alone(kernel, component, "on_finalize", budget)
        if error is not None:
            guarded(
                f"could not tell that on_finalize failed with {format_error(error)}",
                self._report_unfinished,
                component,
                error,
            )
            if issubclass(type(error), KeyboardInterrupt):
                kernel.pass_on_interrupt(error)
        await self.end_tasks(self.tasks.get(component, ()), budget)
        guarded(f"{component.name}: could not look for what is left of it", report_leaks, component)
        there = self._is_there(component)
        self._forget(component)
        if (log := cell(component).log) is not None:
            log.flush()
        if there:
            self._announce_end(component)

    def _report_unfinished(self, component: Component, error: BaseException) -> None:
        chain(error, cell(component).last_error)
        cell(component).last_error = error
        self._kernel.bus.publish(HookFailed(component.name, "", "on_finalize", error, origin_of(error, installed=True)))
        component.log.error("on_finalize failed: %s", located(error), exc_info=error)

    def _forget(self, component: Component) -> None:
        self._disconnect(component)
        if self._is_there(component):
            del self.components[component.name]
            self._cells.pop(component.name, None)
            self._leave_out(component)
        cell(component).alive = False
        for kind in kinds_of(component):
            kind.removed(component)
        for port in component.ports.values():
            wake_waiter(port)
        for task in tuple(self.tasks.get(component, ())):
            task.cancel()

    def _is_there(self, component: Component) -> bool:
        return self.components.get(component.name) is component

    def _leave_out(self, component: Component) -> None:
        if (group := as_group(component)) is not None:
            group.removed()
        if (outer := cell(component).group) is not None:
            outer.member_removed(component)
        self._count(type(component), -1)
        self._kernel._numbering.free(component.name)

    def _count(self, kind: type[Component], change: int) -> None:
        self._kinds[kind] += change
        if not self._kinds[kind]:
            del self._kinds[kind]

    def _disconnect(self, component: Component) -> None:
        for port in component.ports.values():
            self._kernel.connections.end_each(port.connectors)

    # -- what they change ------------------------------------------------------------------------------------------

    def port_added(self, component: Component, port: Port[Any]) -> None:
        """At run time. WiringError when a composite cannot show it: then it is not there."""
        here = cell(component)
        if here.group is not None:
            here.group.check_new_port(component, port)
        for member in here.members:
            member.port_added(port)
        self._kernel.bus.publish(PortAdded(component.name, port.profile))
        if here.group is not None:
            here.group.ports_changed()

    def port_removed(self, component: Component, port: Port[Any]) -> None:
        """Its connectors are gone already."""
        here = cell(component)
        for member in here.members:
            member.port_removed(port)
        self._kernel.bus.publish(PortRemoved(component.name, port.profile))
        if here.group is not None:
            here.group.ports_changed()

    # -- what they started -----------------------------------------------------------------------------------------

    def adopt(self, component: Component, task: asyncio.Task[Any]) -> None:
        """A task that a component started."""
        self.tasks.setdefault(component, set()).add(task)
        task.add_done_callback(partial(self.disown, component))

    def disown(self, component: Component, task: asyncio.Task[Any]) -> None:
        """It has ended, or is ended by other code than the kernel."""
        tasks = self.tasks.get(component)
        if tasks is not None:
            tasks.discard(task)
            if not tasks:
                del self.tasks[component]

    def task_failed(self, component: Component, name: str, error: BaseException) -> None:
        """A task that a component started has failed, and no code has retrieved its exception."""
        if issubclass(type(error), EndingError):
            return  # it waited for a sample, and its component has ended
        guarded("could not add a note", note, error, f"in task {name!r} started by component {component.name}")
        if members := tuple(cell(component).members):
            for member in members:
                member.context.runner.life.task_failed(member, error)
            return
        cell(component).last_error = error
        self._kernel.bus.publish(HookFailed(component.name, "", "task", error, origin_of(error, installed=True)))
        component.log.error("its task %s failed: %s", name, located(error), exc_info=error)
        if issubclass(type(error), KeyboardInterrupt):
            self._kernel.pass_on_interrupt(error)

    async def end_tasks(self, tasks: Iterable[asyncio.Task[Any]], budget: StopBudget) -> None:
        """Cancel these, as often as grace steps allow; what ignores that is abandoned and logged."""
        left = {task for task in tasks if not task.done() and task is not current_task()}
        for task in left:
            owner = owner_of(task)
            if owner is not None:
                _LOG.warning("%s: left task %s running; it is cancelled", owner.name, task.get_name())
        for _ in range(CANCELLATIONS):
            if not left:
                return
            for task in left:
                task.cancel()
            _, left = await asyncio.wait(left, timeout=budget.grace)
        for task in left:
            _LOG.error("task %s ignored %s cancellations and was abandoned", task.get_name(), CANCELLATIONS)
            if (owner := owner_of(task)) is not None:
                self.disown(owner, task)
            abandon_task(task)


def _log_error(task: asyncio.Task[BaseException | None]) -> None:
    error = None if task.cancelled() else task.result()
    if error is not None:
        _LOG.warning("%s failed: %s", task.get_name().removeprefix("aiorts "), error)
