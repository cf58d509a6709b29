"""The components of one kernel: how they come in, what they leave behind, how they go; never two at once for one.

Coming in is all or nothing. Going is a task of the kernel's own, so that whoever asked may be cancelled, be a hook of
the component itself, or ask twice.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Final, TypeVar

from aiorts.errors import ComponentError, DeclarationError, InvalidNameError, StateError, WiringError, said
from aiorts.kernel import embedding
from aiorts.kernel.bus import ComponentAdded, ComponentRemoved, HookFailed, PortAdded, PortRemoved
from aiorts.kernel.chaining import chain
from aiorts.kernel.component import Component
from aiorts.kernel.constructing import construct
from aiorts.kernel.deadlines import CANCELLATIONS, StopBudget
from aiorts.kernel.leftovers import leftovers
from aiorts.kernel.plugins import load_aside
from aiorts.kernel.ports import InPort, Port, ServicePort
from aiorts.kernel.solo import run_alone
from aiorts.kernel.tasks import current_task, kernel_task, leave_behind, owner_of
from aiorts.kernel.unfold import is_composite
from aiorts.model.lifecycle import HOOKS
from aiorts.model.names import Path

if TYPE_CHECKING:
    from aiorts.kernel.kernel import Kernel

__all__ = ("Roster",)

C = TypeVar("C", bound=Component)
_NAMED: Final = 10
"""Instances that a message lists."""
_LOG = logging.getLogger("aiorts.kernel")


class Roster:
    """Who belongs to a kernel, by name, in the order they came."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self.components: dict[str, Component] = {}
        self._kinds: Counter[type[Component]] = Counter()
        """How many there are of each type."""
        self.tasks: dict[Component, set[asyncio.Task[Any]]] = {}
        """Tasks that components started and that have not ended."""
        self._arriving: dict[Component, asyncio.Future[None]] = {}
        self._leaving: dict[Component, asyncio.Task[BaseException | None]] = {}
        self.renewing: set[asyncio.Task[Any]] = set()
        """Reloads that have not come to their end."""
        self.renewal = asyncio.Lock()
        """Held by the one whose turn it is."""
        self.taken_back: set[Component] = set()
        """Instances whose code was taken back, and that stay in their place until a hook of theirs returns."""
        self.composing = asyncio.Lock()
        """Held while a composite changes: one at a time."""

    def find(self, path: str) -> Component | Port[Any]:
        """See `Kernel.find`."""
        where = Path.parse(path)
        component = self.components.get(where.component)
        if component is None:
            raise WiringError(
                f"{path}: no component {where.component!r}; there are {', '.join(self.components) or 'none'}"
            )
        if not where.port:
            return component
        port = component.ports.get(where.port)
        if port is None:
            raise WiringError(
                f"{path}: {where.component} has no port {where.port!r}; it has {', '.join(component.ports) or 'none'}"
            )
        return port

    # -- coming in -------------------------------------------------------------------------------------------------

    async def create(self, kind: type[Component] | str, name: str, params: Mapping[str, object]) -> Component:
        """Make a component of a class, or of a type that a plugin offers by name, and take it in."""
        if isinstance(kind, str):
            offered = self._kernel.plugins.find("components", kind)
            cls: type[Component] = await load_aside(offered, self._kernel.clock, Component)
            self._kernel._require_open("create")  # it may have closed meanwhile
        else:
            cls = kind
        if not (isinstance(cls, type) and issubclass(cls, Component)):
            raise DeclarationError(f"{cls!r}: expected a class derived from Component")
        component = construct(cls, name)
        if name == "" and not component._rt_named:
            component._rt_rename(self._kernel._instance_name(cls))
        return await self.add(component, params)

    async def add(self, component: C, params: Mapping[str, object]) -> C:
        """Take a component in; if its `on_initialize` fails, as if it had never been there."""
        kernel = self._kernel
        self._check_class(component)
        if not component._rt_named:
            component._rt_rename(kernel._instance_name(type(component)))
        self._check_free(component)
        component._rt_put(params)
        component._rt_kernel = kernel
        component._rt_host.kernel = kernel
        self.components[component.name] = component
        self._kinds[type(component)] += 1
        arrived = self._arriving[component] = kernel.loop.create_future()
        try:
            if is_composite(component):
                await component._rt_come()
            await self._initialize(component)
        except BaseException:
            self._forget(component)
            raise
        finally:
            del self._arriving[component]
            arrived.set_result(None)
        for name, port in component.ports.items():
            profile = port.profile if port.name == name else replace(port.profile, name=name)
            kernel.bus.publish(PortAdded(component.name, profile))
        kernel.bus.publish(ComponentAdded(component.name))
        return component

    def _check_class(self, component: Component) -> None:
        if not isinstance(component, Component):
            raise DeclarationError(f"{component!r}: expected a Component instance, got {type(component).__name__}")
        kind = type(component).__name__
        if not hasattr(component, "_rt_host"):
            raise DeclarationError(f"{kind}: super().__init__(name) was not called in its __init__")
        shadowed = [hook for hook in HOOKS if hook in vars(component)]
        if shadowed:
            raise DeclarationError(f"{kind}.{shadowed[0]}: set on the instance; hooks are written in the class")
        if component._rt_kernel is not None:
            raise StateError(
                f"{component.name}: belongs to {component._rt_kernel.name} already, or did; a component is added once"
            )

    def _check_free(self, component: Component) -> None:
        name, kind = component.name, type(component)
        if name in self.components:
            raise InvalidNameError(f"{name}: there is a component of that name in {self._kernel.name}; choose another")
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

    def stranger(self, component: object, name: str, where: str) -> str:
        """What is said of one that is not of this kernel, or whose place another instance has."""
        if name in self.components and getattr(component, "_rt_kernel", None) is self._kernel:
            return f"{name}: another instance has its place; take kernel.components[{name!r}]"
        return f"{name}: does not belong to {where}; await kernel.add(...) first"

    async def _initialize(self, component: Component) -> None:
        error = await run_alone(self._kernel, component, "on_initialize", None)
        if error is None:
            return
        self._kernel.bus.publish(HookFailed(component.name, "", "on_initialize", error))
        if isinstance(error, KeyboardInterrupt):
            self._kernel._interrupted(error)
        if isinstance(error, Exception) and not isinstance(error, StopIteration | StopAsyncIteration):
            raise error
        # A CancelledError or SystemExit of the component must not pass for one of the caller's.
        raise ComponentError(f"{component.name}: on_initialize raised {said(error)}; it was not created") from error

    # -- going -----------------------------------------------------------------------------------------------------

    async def remove(self, component: Component) -> None:
        """Take a component out; asked for by a hook that this would wait for, soon."""
        if component in self._arriving:
            raise StateError(f"{component.name}: cannot be removed while its on_initialize runs")
        task = self._leaving.get(component)
        if task is None:
            task = kernel_task(self._kernel.loop, self._leave(component), f"aiorts remove {component.name}")
            self._leaving[component] = task
            task.add_done_callback(lambda _: self._leaving.pop(component, None))
        if owner_of(current_task()) is component or any(context._inside() for context in component.contexts):
            task.add_done_callback(_log_error)
            return
        error = await asyncio.shield(task)
        if error is not None:
            raise error

    async def _leave(self, component: Component) -> BaseException | None:
        self.vacate(component)
        if is_composite(component):
            from aiorts.kernel import membership

            try:
                await membership.change(component, membership.Wanted(()), 5.0)
            except (TimeoutError, RuntimeError) as error:
                return error
        # Its code may be taken back meanwhile: then it is the old instance that goes.
        while (component := component._rt_successor or component)._rt_members:
            context = component.contexts[0]
            try:
                await context._remove((component,))
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
            if isinstance(port, ServicePort):
                port._vacate(leaving)

    async def close(self, budget: StopBudget) -> None:
        """Take everybody out, in reverse order; contexts have stopped and nobody comes in any more."""
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
            await self._finalize(component, budget)
        await self._end_tasks([task for tasks in self.tasks.values() for task in tasks], budget)
        embedding.settle(self._kernel, self._kernel.loop)

    async def _finalize(self, component: Component, budget: StopBudget) -> None:
        kernel = self._kernel
        self._disconnect(component)
        error = None
        if component._rt_abandoned is None:
            error = await run_alone(kernel, component, "on_finalize", budget)
        if error is not None:
            chain(error, component._rt_last_error)
            component._rt_last_error = error
            kernel.bus.publish(HookFailed(component.name, "", "on_finalize", error))
            component.log.error("on_finalize failed: %s", said(error), exc_info=error)
            if isinstance(error, KeyboardInterrupt):
                kernel._interrupted(error)
        await self._end_tasks(self.tasks.get(component, ()), budget)
        if left := leftovers(component):
            _LOG.warning("%s: left after on_finalize: %s", component.name, ", ".join(left))
        self._forget(component)
        if component._rt_log is not None:
            component._rt_log.flush()
        kernel.bus.publish(ComponentRemoved(component.name))

    def _forget(self, component: Component) -> None:
        self._disconnect(component)
        if self.components.pop(component.name, None) is not None:
            self._leave_out(component)
        component._rt_host.alive = False
        for machine in getattr(component, "_rt_machines", ()):
            machine.remove_participant(component)
        for port in component.ports.values():
            if isinstance(port, InPort | ServicePort):
                port._wake_waiter()
        for task in tuple(self.tasks.get(component, ())):
            task.cancel()

    def _leave_out(self, component: Component) -> None:
        if is_composite(component):
            component._rt_gone()
        if component._rt_composite is not None:
            component._rt_composite._rt_drop(component)
        kind = type(component)
        self._kinds[kind] -= 1
        if not self._kinds[kind]:
            del self._kinds[kind]
        self._kernel._numbering.free(component.name)

    def _disconnect(self, component: Component) -> None:
        for port in component.ports.values():
            for connector in port.connectors:
                self._kernel._connections.end(connector)

    # -- what they change ------------------------------------------------------------------------------------------

    def port_added(self, component: Component, port: Port[Any]) -> None:
        """At run time. WiringError when a composite cannot show it: then it is not there."""
        if component._rt_composite is not None:
            component._rt_composite._rt_check_new_port(component, port)
        for member in component._rt_members:
            member.context._port_added(member, port)
        self._kernel.bus.publish(PortAdded(component.name, port.profile))
        if component._rt_composite is not None:
            component._rt_composite._rt_ports_changed()

    def port_removed(self, component: Component, port: Port[Any]) -> None:
        """Its connectors are gone already."""
        for member in component._rt_members:
            member.context._port_removed(member, port)
        self._kernel.bus.publish(PortRemoved(component.name, port.profile))
        if component._rt_composite is not None:
            component._rt_composite._rt_ports_changed()

    # -- what they started -----------------------------------------------------------------------------------------

    def adopt(self, component: Component, task: asyncio.Task[Any]) -> None:
        """A task that a component started."""
        self.tasks.setdefault(component, set()).add(task)
        task.add_done_callback(partial(self._disown, component))

    def _disown(self, component: Component, task: asyncio.Task[Any]) -> None:
        tasks = self.tasks.get(component)
        if tasks is not None:
            tasks.discard(task)
            if not tasks:
                del self.tasks[component]

    def task_failed(self, component: Component, name: str, error: BaseException) -> None:
        """A task that a component started has failed and nobody asked for its exception."""
        error.add_note(f"in task {name!r} started by component {component.name}")
        if component._rt_members:
            for member in tuple(component._rt_members):
                member.context._life.task_failed(member, error)
            return
        component._rt_last_error = error
        self._kernel.bus.publish(HookFailed(component.name, "", "task", error))
        component.log.error("its task %s failed: %s", name, said(error), exc_info=error)

    async def _end_tasks(self, tasks: Any, budget: StopBudget) -> None:
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
            _LOG.error("task %s ignored %s cancellations and was left behind", task.get_name(), CANCELLATIONS)
            if (owner := owner_of(task)) is not None:
                self._disown(owner, task)
            leave_behind(task)


def _log_error(task: asyncio.Task[BaseException | None]) -> None:
    error = None if task.cancelled() else task.result()
    if error is not None:
        _LOG.warning("%s failed: %s", task.get_name().removeprefix("aiorts "), error)
