"""Adds and removes members of a running composite: each change takes effect between two cycles, whole or not at all.

A new member leaves its own contexts first; then one action in the composite's context takes in new members, releases
others and lays out the order, so that no cycle sees half of the change. A failure is undone: all are back in their
places.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any

from aiorts.composites import composition_check, parallel
from aiorts.composites.composition import Export
from aiorts.composites.previous_placement import leave_contexts, return_to_contexts
from aiorts.errors import AiortsError, ComponentError, StateError, TransitionTimeout, format_error
from aiorts.kernel.execution.cell import cell, flattened
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.kernel.loop.tasks import kernel_task
from aiorts.late import dataclass
from aiorts.model.lifecycle import Event, LifecycleState
from aiorts.model.policy import ErrorPolicy

if TYPE_CHECKING:
    from aiorts.composites.group import CompositeGroup
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.cycle import Done, Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel
    from aiorts.kernel.ports.connector import Connector

__all__ = (
    "Wanted",
    "change",
    "enter",
    "return_to_contexts",
    "leave",
    "leave_contexts",
    "start",
    "transition",
)

_LOG = KernelLog()
_ACTIVE, _ERROR, _INACTIVE = LifecycleState.ACTIVE, LifecycleState.ERROR, LifecycleState.INACTIVE
_FROM = {Event.ACTIVATE: _INACTIVE, Event.DEACTIVATE: _ACTIVE, Event.RESET: _ERROR}
_PATIENCE = 5.0
"""Seconds of the kernel's clock that a context may take to release a component."""


@dataclass(slots=True)
class _Move:
    """One change of a context's members and their order; carried out by the context between two cycles."""

    context: Context
    composite: CompositeGroup
    joining: Sequence[Member]
    leaving: Sequence[Component]
    line: Sequence[Component]
    """All components of the composite afterwards, in order of execution."""
    commit: Callable[[], None]
    over: asyncio.Future[BaseException | None]
    begun: bool = False

    def steps(self, notify: Done) -> Steps:
        """The steps of the change, as one action."""
        self.begun = True
        context, life = self.context, self.context.runner.life

        def done(error: BaseException | None) -> None:
            context.runner.kernel.call_on_loop(lambda: self.over.set_result(error))
            notify(error)

        try:
            for member in self.joining:
                context.runner.check_may_join(member.component)
        except StateError as error:
            done(error)
            return
        active = any(m.active for part in self.composite.parts for m in cell(part).members if m.context is context)
        joined: list[Member] = []
        failure: BaseException | None = None
        for member in self.joining:
            joined.append(member)
            yield from life.add(member)
            if active and member.failure is None:
                yield from life.activate(member)
            failure = member.failure
            if failure is not None:
                break
        if failure is not None:
            for member in reversed(joined):
                yield from life.remove(member)
            name = joined[-1].component.name
            failed = ComponentError(
                f"{self.composite.name}: {name} could not join: {format_error(failure)}; nothing was changed"
            )
            failed.__cause__ = failure
            done(failed)
            return
        for component in reversed(self.leaving):
            for member in tuple(cell(component).members):
                if member.context is context:
                    yield from life.remove(member)
        self.commit()
        context.runner.arrange(self.line)
        parallel.lay_out_parallel(context)
        done(None)


# -- changes -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Wanted:
    """A requested change of a composite; None keeps the present value."""

    members: Sequence[Component | str] | None = None
    rules: Sequence[Export] | None = None
    order: str | None = None
    groups: str | Sequence[Sequence[str]] | None = None
    adding: Sequence[Component | str] = ()
    removing: Sequence[str] = ()
    """The names of members to remove."""

    def given(self, composite: CompositeGroup) -> Sequence[Component | str]:
        """The requested members, computed only when this change is carried out: another change may come before it."""
        members = composite.members if self.members is None else self.members
        here = [member.name for member in composite.members]
        for name in self.removing:
            if name not in here:
                raise StateError(f"{name}: is no member of {composite.name}; it has {', '.join(here) or 'none'}")
        kept = [
            one for one in members if (one if isinstance(one, str) else getattr(one, "name", "")) not in self.removing
        ]
        return [*kept, *self.adding]


async def change(composite: CompositeGroup, wanted: Wanted, timeout: float | None) -> tuple[Connector, ...]:
    """See `Composite.change`. Once begun it goes on even if the caller is cancelled."""
    kernel = composite.kernel
    kernel.check_mine(composite.component, "change")
    given = wanted.given(composite)
    concerned = composition_check.resolved(
        kernel, composite, [one for one in given if not (isinstance(one, str) and kernel.registry.is_elsewhere(one))]
    )
    contexts = {context for component in (composite.component, *concerned) for context in component.contexts}
    queued = any(context.runner.inside() for context in contexts)
    task = kernel_task(kernel.loop, _change(composite, wanted, timeout), f"aiorts change {composite.name}")
    task.add_done_callback(_log_error if queued else _retrieve)
    return () if queued else await asyncio.shield(task)


async def _change(composite: CompositeGroup, wanted: Wanted, timeout: float | None) -> tuple[Connector, ...]:
    kernel = composite.kernel
    async with kernel.registry.composing:
        kernel.check_mine(composite.component, "change")
        given = wanted.given(composite)
        try:
            there = await composite.bring_in(given)
            after = composition_check.resolved(kernel, composite, there)
            composition_check.check(composite, after, wanted.rules)
            groups = composition_check.grouped(composite, after, wanted.groups)
        except BaseException:
            await composite.let_go([one for one in composite.brought if one not in composite.members])
            raise
        order = wanted.order or composite.order
        before = composite.members
        inside = frozenset(port for part in composition_check.leaves_of(before) for port in part.ports.values())
        joining = [component for component in after if component not in before]
        leaving = [component for component in before if component not in after]
        for component in joining:
            cell(component).group = composite
        context = composite.context

        def commit() -> None:
            composite.order, composite.groups, composite.members = order, groups, tuple(after)
            composite.root.lay_out()

        try:
            if context is not None:
                parallel.check_groups(composite.name, groups, context)
                line = composite.line(composite.ordered(after, order, groups))
                await _move(context, composite, line, commit, timeout)
        except BaseException:
            for component in joining:
                cell(component).group = None
            for component in reversed(composition_check.leaves_of(joining)):
                await return_to_contexts(component, timeout)
            await composite.let_go(joining)
            raise
        for component in leaving:
            cell(component).group = None
        commit()
        if wanted.rules is not None:
            composite.exports = tuple(wanted.rules)
        ended = composite.have_members(after, inside)
        composite.publish_change(joining, leaving, ended)
        for component in reversed(composition_check.leaves_of(leaving)):
            await return_to_contexts(component, timeout)
        await composite.let_go(leaving)
        composite.publish_state()
        return ended


async def _move(
    context: Context,
    composite: CompositeGroup,
    line: Sequence[Component],
    commit: Callable[[], None],
    timeout: float | None,
) -> None:
    """Make these the parts of the composite, in this order."""
    now = composite.parts
    joining = [part for part in line if part not in now]
    leaving = [part for part in now if part not in line]
    whole = composite.root.parts
    before = whole[: whole.index(now[0])] if now else whole
    rest = [part for part in whole[len(before) :] if part not in now]
    await _carry_out(context, composite, joining, leaving, [*before, *line, *rest], commit, timeout)


async def _carry_out(
    context: Context,
    composite: CompositeGroup,
    joining: Sequence[Component],
    leaving: Sequence[Component],
    line: Sequence[Component],
    commit: Callable[[], None],
    timeout: float | None,
) -> None:
    for component in joining:
        await leave_contexts(component, timeout)
        context.runner.check_may_join(component)
    over: asyncio.Future[BaseException | None] = context.runner.kernel.loop.create_future()
    move = _Move(context, composite, [context.runner.new_member(c) for c in joining], leaving, line, commit, over)
    try:
        await context.runner.ask([(f"change {composite.name}", move.steps)], timeout)
    except TransitionTimeout:
        # A change that has begun is completed: undone halfway, a component would run in two contexts.
        driver = context.runner.driver
        if not move.begun or driver is None:
            raise
        either: list[asyncio.Future[Any]] = [over, driver.ended]
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        error = over.result() if over.done() else StateError(f"{context.name}: stopped meanwhile")
        if error is not None:
            raise error from None


# -- contexts ------------------------------------------------------------------------------------------------------


async def start(
    kernel: Microkernel, context: Context, components: Sequence[Component], *, activate: bool, timeout: float | None
) -> None:
    """Start a context with composites among its components; if that fails their members are back in their places."""
    async with kernel.registry.composing:
        composites = tuple(filter(None, map(composition_check.group_of, components)))
        for composite in composites:
            composite.check_startable()
        parts: list[Component] = []
        for composite in composites:
            composite.lay_out()
            parallel.check_groups(composite.name, composite.sections(), context)
        for composite in composites:
            composite.enter_context(context)
            parts += composite.parts
        try:
            for part in parts:
                await leave_contexts(part, _PATIENCE)
            parallel.divide(context, composites)
            await context.runner.begin(kernel, flattened(components), activate=activate, timeout=timeout)
        except BaseException:
            if not context.running:
                context.runner.let_go()
                for composite in composites:
                    composite.enter_context(None)
                for part in reversed(parts):
                    await return_to_contexts(part, _PATIENCE)
            raise


async def enter(context: Context, given: Sequence[Component], timeout: float | None) -> None:
    """Add composites to a running context, one after the other, as `Context.add`."""
    kernel = context.runner.check("add")
    async with kernel.registry.composing:
        for component in given:
            kernel.check_mine(component, "add")
            composite = composition_check.group_of(component)
            if composite is None:
                await context.add(component, timeout=timeout)
                continue
            composite.check_startable()
            composite.lay_out()
            parallel.check_groups(composite.name, composite.sections(), context)
            composite.enter_context(context)
            line = composite.parts
            try:
                await _carry_out(context, composite, line, (), line, lambda: None, timeout)
            except BaseException:
                composite.enter_context(None)
                for part in reversed(line):
                    await return_to_contexts(part, timeout)
                raise


async def leave(context: Context, given: Sequence[Component], timeout: float | None) -> None:
    """Remove composites from a running context, as `Context.remove`; their members stay without a context."""
    kernel = context.runner.check("remove")
    async with kernel.registry.composing:
        for component in given:
            members = [context.runner.member(part) for part in composition_check.parts_of(component)]
            await context.runner.ask([context.runner.leaving(member) for member in reversed(members)], timeout)
            if (composite := composition_check.group_of(component)) is not None:
                composite.enter_context(None)
        parallel.lay_out_parallel(context)


# -- lifecycle -----------------------------------------------------------------------------------------------------


async def transition(composite: CompositeGroup, event: Event, timeout: float | None) -> None:
    """Request a transition of all members of a composite, in one action between two cycles.

    Members that all have a schedule of their own are asked one after the other.
    """
    if composite.is_spread:
        await _transition_of_groups(composite, event, timeout)
        return
    context = composite.component.context
    context.runner.check(event.value)
    await context.runner.ask(
        [(f"{event} {composite.name}", lambda done: _transition(composite, context, event, done))], timeout
    )


async def _transition_of_groups(composite: CompositeGroup, event: Event, timeout: float | None) -> None:
    stops = composite.errors is ErrorPolicy.STOP and event is Event.ACTIVATE
    if stops and composite.state is _ERROR:
        raise StateError(f"{composite.name}: cannot activate from error; reset it first")
    groups = [group for member in composite.laid_out if (group := composition_check.group_of(member)) is not None]
    failed: AiortsError | None = None
    begun: list[CompositeGroup] = []
    for group in reversed(groups) if event is Event.DEACTIVATE else groups:
        if group.state is not _ACTIVE:
            begun.append(group)
        try:
            await transition(group, event, timeout)
        except AiortsError as error:
            failed = failed or error
            if stops:
                break
    if failed is not None:
        for group in reversed(begun) if stops else ():
            if group.state is _ACTIVE:
                await transition(group, Event.DEACTIVATE, timeout)
        raise failed


def _transition(composite: CompositeGroup, context: Context, event: Event, done: Done) -> Steps:
    members = [m for part in composite.parts for m in cell(part).members if m.context is context]
    stops = composite.errors is ErrorPolicy.STOP
    if event is Event.ACTIVATE and stops and composite.state is _ERROR:
        done(StateError(f"{composite.name} in {context.name}: cannot activate from error; reset it first"))
        return
    if event is Event.DEACTIVATE:
        members.reverse()
        for member in members:
            member.stopped_for = frozenset()  # from now on they are inactive by request
    failed: list[BaseException] = []
    begun: list[Member] = []
    for member in members:
        if member.state is not _FROM[event]:
            continue
        outcome: list[BaseException | None] = []
        yield from context.runner.life.request(member, event, outcome.append)
        begun.append(member)
        if outcome and outcome[0] is not None:
            failed.append(outcome[0])
            if event is Event.ACTIVATE and stops:
                break
    if failed and event is Event.ACTIVATE and stops:
        yield from _deactivate(reversed(begun))
    done(failed[0] if failed else None)


def _deactivate(members: Iterable[Member]) -> Steps:
    for member in tuple(members):
        if member.active and not member.left:
            yield from member.context.runner.life.deactivate(member)


# -- for the log -----------------------------------------------------------------------------------------------------


def _retrieve(task: asyncio.Task[Any]) -> None:
    if not task.cancelled():
        task.exception()


def _log_error(task: asyncio.Task[Any]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        _LOG.warning("queued %s failed: %s", task.get_name().removeprefix("aiorts "), error)
