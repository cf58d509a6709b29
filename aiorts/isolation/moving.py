"""Moves a component to another context, or into a process and back, while its neighbours run.

Slow work is done first, while the component still runs: the process is started, the other instance made. Then the
component leaves its context, with its in-ports open. In one moment of the loop the other instance gets its place and
its connectors, with the unread samples; then state goes over, and the instance is started.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AsyncExitStack, suppress
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from aiorts.composites import Composite
from aiorts.contexts import PeriodicContext
from aiorts.errors import AiortsError, DeclarationError, ProcessError, StateError, TransitionTimeout
from aiorts.isolation.handover import give_state, hold, put_in_front, release, state_of, taken, unpacked
from aiorts.isolation.isolating import Isolation
from aiorts.isolation.pausing import threads_paused
from aiorts.isolation.placing import RemoteContext, given_of
from aiorts.isolation.stand_in import RemoteComponent
from aiorts.kernel.component import Component, construct
from aiorts.kernel.detached_hook import run_alone
from aiorts.kernel.execution.cell import ATTRIBUTE, as_group, cell, check_free
from aiorts.kernel.execution.context import Context
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task, see_through
from aiorts.kernel.ports import PortDeclaration
from aiorts.kernel.ports.connector import Connector, transport_of, unread_of
from aiorts.kernel.ports.port import host_of
from aiorts.kernel.quality.succession import pass_on
from aiorts.links import Links
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.options import AGAIN, chosen_options, link_options, said_options
from aiorts.model.service_profile import ServiceConnectorProfile
from aiorts.services import ServicePort
from aiorts.supervision import place_of

if TYPE_CHECKING:
    from aiorts.kernel.microkernel import Microkernel

_LOG: Final = KernelLog()
_PATIENCE: Final = 5.0
"""Seconds in which samples that were written must arrive."""
_SETTLES: Final = 0.5
"""Seconds in which the other end of a link acknowledges all samples."""
_LOOK: Final = 0.001


async def move(kernel: Microkernel, component: Component, to: Context | str, limits: Mapping[str, Any]) -> Component:
    """See `Kernel.move`."""
    kernel.check_mine(component, "move")
    if any(context.runner.inside() for context in component.contexts):
        raise StateError(f"{component.name}: move: called by a hook that it would wait for; call it from outside")
    task = kernel_task(kernel.loop, _moved(kernel, component, to, limits), f"aiorts move {component.name}")
    renewing = kernel.registry.renewing
    renewing.add(task)
    task.add_done_callback(renewing.discard)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        task.add_done_callback(_log_error)
        raise


def _log_error(task: asyncio.Task[Component]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _LOG.error("move: %s", error)


async def _moved(kernel: Microkernel, component: Component, to: Context | str, limits: Mapping[str, Any]) -> Component:
    async with kernel.registry.renewal:
        kernel.check_open("move")
        _check(kernel, component, to)
        if isinstance(to, Context):
            if not isinstance(component, RemoteComponent):
                return await _change_context(kernel, component, to)
            return await _exchange(
                kernel, component, await _make_replacement(kernel, component, component.original), to
            )
        if isinstance(component, RemoteComponent):
            raise StateError(f"{component.name}: runs in a process of its own already")
        cls = kernel.service(Isolation).stand_in(type(component), limits)
        if cls is type(component):
            return component  # on a simulated clock, which was said
        alike = _alike(kernel, component)
        return await _exchange(kernel, component, await _make_replacement(kernel, component, cls), alike)


async def make_replacement(kernel: Microkernel, component: Component, limits: Mapping[str, Any] | None) -> Component:
    """Make another instance for the place of a component that is in at most one context; it is parked.

    Args:
        limits: what its process may use; None for an instance in this process.

    Raises:
        StateError, WiringError, DeclarationError: names what keeps it from that place. Also what making it raises.
    """
    _check(kernel, component, "process")
    if limits is not None:
        return await _make_replacement(kernel, component, kernel.service(Isolation).stand_in(type(component), limits))
    return await _make_replacement(kernel, component, getattr(type(component), "original", type(component)))


async def exchange(kernel: Microkernel, old: Component, new: Component) -> None:
    """Put the instance that `make_replacement` has made in the place of a component that is in no context.

    The new instance takes over state and connectors. Its in-ports take samples until `hold_at` ends that.

    Raises:
        AiortsError: the reason why the old instance is still in its place; the new one has ended.
    """
    await _exchange(kernel, old, new, None, held=True)


async def hold_at(component: Component, holds: bool) -> None:
    """Keep the in-ports of a component open, wherever it runs and whatever its state is; False: no longer."""
    with suppress(ProcessError):  # of the process, which has ended: that is its failure, as always
        await _place_of(component).hold(holds)


def _check(kernel: Microkernel, component: Component, to: Context | str) -> None:
    name = component.name
    kernel.registry.check_settled(component)
    check_free((component,), "move")
    if as_group(component) is not None or issubclass(getattr(type(component), "original", Component), Composite):
        raise StateError(f"{name}: is a composite; move its members, or stop it")
    if not isinstance(to, Context) and to != "process":
        raise DeclarationError(f'{name}: move to {to!r:.80}: expected a context, or "process"')
    if isinstance(to, RemoteContext):
        raise StateError(f'{name}: {to.name} runs in the process of its member; move it to "process"')
    if len(component.contexts) > 1:
        raise StateError(f"{name}: is in {len(component.contexts)} contexts; a component that is in one can be moved")
    if cell(component).abandoned is not None or LifecycleState.ERROR in component.states.values():
        raise StateError(f"{name}: is in error; reset it first, or remove it")
    if to in component.contexts:
        raise StateError(f"{name}: is in {component.context.name} already")


# -- between contexts of this kernel -------------------------------------------------------------------------------


async def _change_context(kernel: Microkernel, component: Component, to: Context) -> Component:
    """Put the same instance into another context; if that refuses it, put it back into the former context."""
    before = component.contexts[0] if component.contexts else None
    active = before is not None and before.state(component) is LifecycleState.ACTIVE
    hold(component)
    try:
        if before is not None:
            await before.remove(component)
        try:
            await _join(kernel, component, to, active=active)
        except BaseException:
            if before is not None and before.running and not component.contexts:
                await _join(kernel, component, before, active=active)
            raise
    finally:
        release(component)
    return component


async def _join(kernel: Microkernel, component: Component, to: Context, *, active: bool) -> None:
    if not to.running:
        await kernel.start(to, component, activate=active)
        return
    await to.add(component)
    if active:
        await to.activate(component)


def _alike(kernel: Microkernel, component: Component) -> Context | None:
    """A new context for the component alone, of the kind of its present one. For a real-time context it is a periodic
    one, as a real-time thread could not read from links.

    Raises:
        StateError: another process cannot have a context of this kind.
    """
    if not component.contexts:
        return None
    like = component.contexts[0]
    if like.kind == "external":
        raise StateError(
            f"{component.name}: {like.name} is ticked by this program, which cannot tick it in another process; move "
            "it to a periodic context first"
        )
    options: dict[str, Any] = RemoteContext(like).as_started()["options"]
    cls = type(like)
    if like.kind == "realtime" and like.rate is not None:
        cls, options = PeriodicContext, {"rate": like.rate}
    name, number = f"{like.name}_{component.name}", 2
    while name in kernel.contexts:
        name, number = f"{like.name}_{component.name}{number}", number + 1
    try:
        return cls(name=name, **options)
    except TypeError as error:
        raise StateError(f"{component.name}: {like.name}: a context of its kind cannot be made anew: {error}") from None


# -- to and from a process -----------------------------------------------------------------------------------------


class _Here:
    """An instance in this process."""

    def __init__(self, component: Component) -> None:
        self._component = component

    async def prepare(self, _to: Context | None) -> None:
        """Prepare the instance to run in such a context."""
        await self.hold(True)

    async def state(self) -> Mapping[str, Any]:
        """The attributes of the instance. StateError: an attribute cannot go over."""
        return state_of(self._component)

    async def give(self, kernel: Microkernel, state: Mapping[str, Any]) -> None:
        """Set these attributes."""
        await give_state(kernel, self._component, state)

    async def hold(self, holds: bool) -> None:
        """Let the instance take samples whatever its state is, or no longer."""
        (hold if holds else release)(self._component)

    async def leave(self, context: Context) -> None:
        """Take the instance out of its context."""
        await context.remove(self._component)


class _There:
    """An instance in a process of its own."""

    def __init__(self, component: RemoteComponent) -> None:
        self._component = component

    async def prepare(self, to: Context | None) -> None:
        """Prepare the process to run such a context: import what its start needs, which takes 0.1 s."""
        await self.hold(True)
        if to is not None:
            await self._component.ask("start_context", members=[], **RemoteContext(to).as_started())
            await self._component.ask("stop_context", context=to.name)

    async def state(self) -> Mapping[str, Any]:
        """The attributes of the instance. StateError: an attribute cannot go over."""
        found: Mapping[str, Any] = await self._component.ask("state")
        return found

    async def give(self, _kernel: Microkernel, state: Mapping[str, Any]) -> None:
        """Set these attributes."""
        await self._component.ask("give", state=state)

    async def hold(self, holds: bool) -> None:
        """Let the instance take samples whatever its state is, or no longer."""
        await self._component.ask("hold", holds=holds)

    async def leave(self, context: Context) -> None:
        """Stop the context, and with it the instance."""
        await context.stop()


def _place_of(component: Component) -> _Here | _There:
    return _There(component) if isinstance(component, RemoteComponent) else _Here(component)


async def _make_replacement(kernel: Microkernel, old: Component, cls: type[Component]) -> Component:
    """Make another instance if the old one can be moved; a refusal comes before anything is changed."""
    await _Move(kernel, old).here.state()
    return await _make(kernel, old, cls)


async def _exchange(
    kernel: Microkernel, old: Component, new: Component, to: Context | None, *, held: bool = False
) -> Component:
    """Put another instance, in another process, in the place of the old one; a failure undoes all steps."""
    try:
        move, active = _Move(kernel, old), LifecycleState.ACTIVE in old.states.values()
    except BaseException:
        await kernel.registry.end_parked(new)
        raise
    there = _place_of(new)
    async with AsyncExitStack() as undo:
        undo.push_async_callback(kernel.registry.end_parked, new)
        undo.push_async_callback(move.here.hold, False)
        undo.push_async_callback(move.go_on, active=active)
        await there.prepare(to)
        await move.here.hold(True)
        await move.leave()
        state = await move.here.state()
        async with move.neighbours_paused():
            move.switch(new)
            undo.push_async_callback(move.undo, new)
        await move.arrive()
        await there.give(kernel, state)
        if to is not None:
            await _join(kernel, new, to, active=active)
        undo.pop_all()
    await move.settle()
    if not held:
        await hold_at(new, False)
    await kernel.registry.end_parked(old)
    _disown(old, new)
    return new


async def _make(kernel: Microkernel, old: Component, cls: type[Component]) -> Component:
    """Make the other instance and run its `on_initialize`; it does not take the old one's place yet.

    Raises:
        StateError: the new instance has other ports. Also what making it raises.
    """
    new = construct(cls, old.name)
    place_of(old).configure(new)
    here = cell(new)
    here.kernel = kernel
    error = await run_alone(kernel, new, "on_initialize", None, limit=kernel.initialize_timeout)
    kernel.registry.parked.add(new)
    if error is None and new.ports.keys() != old.ports.keys():
        odd = ", ".join(new.ports.keys() ^ old.ports.keys())
        error = StateError(f"{old.name}: {odd}: was added while it ran, or removed; such ports cannot be moved")
    if error is not None:
        await kernel.registry.end_parked(new)
        raise error
    here.deadlines = cell(old).deadlines
    return new


class _Move:
    """The place, the connectors and the unread samples that another instance takes over from an old one.

    Raises:
        StateError, WiringError: a connector cannot be made there.
    """

    def __init__(self, kernel: Microkernel, old: Component) -> None:
        self._kernel, self._old = kernel, old
        self.here = _place_of(old)
        self.context = old.contexts[0] if old.contexts else None
        """The context in which the old instance ran."""
        self._links = kernel.service(Links)
        self._options = {one: self._options_of(one) for one in self._connectors()}
        self._fed: list[tuple[Connector, Connector]] = []
        """Connectors that the old instance read, each with the connector that the new instance reads."""
        self._made: list[Connector] = []

    async def leave(self) -> None:
        """Stop the old instance, and wait until all samples that it wrote are here."""
        if self.context is not None:
            await self.here.leave(self.context)
        await self._wait_for("what it wrote to be taken", self._has_all_arrived)

    async def go_on(self, *, active: bool) -> None:
        """Run the old instance again in its context, if it has left that."""
        if self.context is not None and not self._old.contexts:
            await _join(self._kernel, self._old, given_of(self.context), active=active)

    async def arrive(self) -> None:
        """Wait until the unread samples of the old process are here, and links lead to the new instance."""
        await self._unread()
        for connector in self._made:
            await self._links.connect(_there_already, (connector,), {})

    def _connectors(self) -> list[Connector]:
        """The data connectors of the old instance; a connector between two of its ports appears once."""
        ports = [port for port in self._old.ports.values() if not isinstance(port, ServicePort)]
        return list(dict.fromkeys(one for port in ports for one in port.connectors))

    def _reads(self, connector: Connector) -> bool:
        """Whether the old instance reads from the connector."""
        port = connector.in_
        return port in self._old.ports.values() or str(getattr(port, "far", "")) in self._elsewhere()

    def _elsewhere(self) -> set[str]:
        """The kernels of the old instance's ports, if it is in a process."""
        return {str(port.elsewhere) for port in self._old.ports.values() if port.elsewhere is not None}

    def _options_of(self, connector: Connector) -> dict[str, Any]:
        """The options of the connector that replaces this one.

        Raises:
            StateError, WiringError: it cannot be made there.
        """
        old, profile = self._old, connector.profile
        where = f"{connector.out.path} -> {connector.in_.path}"
        reads = self._reads(connector)
        other = host_of(connector.out if reads else connector.in_)
        if other is not None and other.realtime:
            raise StateError(
                f"{old.name}: {where}: {other.name} runs in a real-time thread, which has no links; move it to a "
                "context of the loop or to a thread context first"
            )
        if isinstance(old, RemoteComponent):
            known = dict(old.before.get(profile.name, {}))
            return known or {**said_options(profile), "on_link_lost": None, "length": profile.length}
        if connector.in_.is_far or connector.out.is_far:
            raise StateError(
                f"{old.name}: {where}: one end is in another process, and both cannot be; disconnect it first, "
                "or move the other one back"
            )
        if connector.out in old.ports.values() and reads:
            raise StateError(f"{old.name}: {where}: both ends are its own; disconnect it first")
        given = chosen_options(profile) | {"length": profile.length, "convert": profile.convert}
        return link_options(where, given, from_reader=not reads)

    def neighbours_paused(self) -> AbstractAsyncContextManager[None]:
        """A context manager in which no neighbour reads or writes in a thread of its own."""
        paths = {path.partition(".")[0] for one in self._options for path in (one.out.path, one.in_.path)}
        components = self._kernel.components
        return threads_paused(self._kernel, [components[name] for name in paths if name in components])

    # -- one moment ------------------------------------------------------------------------------------------------

    def switch(self, new: Component) -> None:
        """Give the new instance the old one's place and connectors, with the samples that are unread here."""
        kernel, old, options = self._kernel, self._old, self._options
        calls = [profile for profile, _ in place_of(old).connectors if isinstance(profile, ServiceConnectorProfile)]
        for profile in calls:
            kernel.connections.end(kernel.service_connectors[profile.name])
        before = {one.name: chosen_options(one.profile) | {"length": one.profile.length} for one in options}
        for connector in options:
            kernel.connections.park(connector)
        kernel.registry.supersede(old, new)
        if isinstance(new, RemoteComponent):
            new.before = before
        for connector, chosen in options.items():
            reads = self._reads(connector)
            ports: Any = (
                (connector.out, new.ports[connector.in_.path.rpartition(".")[2]])
                if reads
                else (new.ports[connector.out.path.rpartition(".")[2]], connector.in_)
            )
            given = {**chosen, **AGAIN, "name": connector.name}
            (made,) = kernel.connections.make(ports, given)
            self._made.append(made)
            if transport_of(connector).losses is not None:  # the length is given here: it seems to be chosen
                kernel.connections.losses.listen(made)
            if reads:
                self._fed.append((connector, made))
                if isinstance(old, RemoteComponent):
                    continue  # what is unread lies in the process
                put_in_front(made, taken(connector))
            elif isinstance(old, RemoteComponent):
                pass_on(connector, made)
            else:
                # The other is a link, which counts what comes over it alone.
                kernel.service(Isolation).end_when_read(connector)
                continue
            kernel.connections.end(connector)
        for profile in calls:
            kernel.connections.renew(profile, reports_losses=False)

    # -- what is on its way ----------------------------------------------------------------------------------------

    async def _unread(self) -> None:
        """Fetch the unread samples of the old process, and put them before the samples that came meanwhile."""
        old = self._old
        if not isinstance(old, RemoteComponent):
            return
        unread: dict[tuple[str, str], list[Any]] = {}

        async def take_out() -> None:
            for port, writer, samples in await old.ask("unread"):
                unread.setdefault((port, writer), []).extend(samples)

        async def has_all_come() -> bool:
            # Samples are fetched again and again: that makes room in the full buffers of ports for samples that wait.
            is_all_sent = await self._is_all_sent()
            # If the request were cancelled, its answer and the samples in the answer would be lost.
            await see_through(kernel_task(self._kernel.loop, take_out(), f"aiorts move {old.name}"))
            return is_all_sent

        try:
            await self._wait_for("what was written to it to arrive", has_all_come)
        finally:  # what was taken out is in no buffer: it goes on here, or is passed on when the move is taken back
            for connector, made in self._fed:
                key = made.in_.name, str(self._links.path_of(connector.out))
                put_in_front(made, [unpacked(one) for one in unread.get(key, ())])

    async def settle(self) -> None:
        """End the links of the old instance, once their other ends have acknowledged all samples."""
        fed = [connector for connector, _ in self._fed if connector.in_.is_far]
        await self._links.ends.sent(fed, _SETTLES)
        for connector in fed:
            self._kernel.connections.end(connector)

    async def undo(self, new: Component) -> None:
        """Give the place back to the old instance; the process of either instance may be gone."""
        await self.settle()
        back = _Move(self._kernel, new)
        for step in (partial(back.here.hold, True), back.leave):
            with suppress(AiortsError):
                await step()
        async with AsyncExitStack() as paused:
            with suppress(TransitionTimeout):
                await paused.enter_async_context(back.neighbours_paused())
            back.switch(self._old)
        with suppress(AiortsError):
            await back.arrive()
        await back.settle()

    async def _is_all_sent(self) -> bool:
        """Whether the process has received all samples that were written to the old instance."""
        for connector, _ in self._fed:
            if unread_of(connector) or (await self._links.ledger(connector)).in_flight:
                return False
        return True

    async def _has_all_arrived(self) -> bool:
        """Whether all samples that the old instance wrote are here."""
        if isinstance(self._old, RemoteComponent):
            for connector in self._connectors():
                if not self._reads(connector):
                    ledger = await self._links.ledger(connector)
                    if ledger.in_flight or ledger.buffered > unread_of(connector):
                        return False
        return True

    async def _wait_for(self, what: str, holds: Callable[[], Awaitable[bool]]) -> None:
        try:
            async with asyncio.timeout(_PATIENCE):
                while not await holds():  # noqa: ASYNC110 - of another process, which says nothing by itself
                    await asyncio.sleep(_LOOK)
        except TimeoutError:
            raise TransitionTimeout(f"{self._old.name}: move: waited {_PATIENCE:g} s for {what}") from None


async def _there_already(connectors: Sequence[Connector], options: Mapping[str, Any]) -> Connector:
    return connectors[0]


class _Moved:
    """The stand-in for the ports and the cell of an old handle: each use raises."""

    __slots__ = ("text",)

    def __init__(self, text: str) -> None:
        self.text = text

    def __getattribute__(self, name: str) -> Any:
        raise StateError(object.__getattribute__(self, "text"))


def _disown(old: Component, new: Component) -> None:
    """Let each use of the old handle raise, and name the new one."""
    moved = _Moved(f"{new.name}: this handle is not valid since it was moved; use what `move` returned, {new!r}")
    ports = [name for name, value in vars(old).items() if isinstance(value, PortDeclaration)]
    vars(old).clear()
    vars(old).update(dict.fromkeys((ATTRIBUTE, *ports), moved))
