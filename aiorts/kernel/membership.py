"""How members of a composite come and go while everything runs: all of a change between two cycles, or nothing of it.

Who joins leaves its own contexts first; then one action in the composite's context takes in who joins, lets go who
leaves and lays out the order, so that no cycle sees half of it. What fails is undone: everybody is back where he was.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from aiorts.errors import ComponentError, StateError, TransitionTimeout, said
from aiorts.kernel import composition_check, lanes
from aiorts.kernel.bus import MemberAdded, MemberRemoved
from aiorts.kernel.homes import arrange, go_home, leave_home
from aiorts.kernel.tasks import kernel_task
from aiorts.kernel.unfold import is_composite, unfolded
from aiorts.model.composition import ErrorPolicy, Export
from aiorts.model.lifecycle import Event, LifeCycleState

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.composed import Composed
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context
    from aiorts.kernel.kernel import Kernel
    from aiorts.kernel.life import Done, Steps
    from aiorts.kernel.member import Member

__all__ = (
    "Wanted",
    "change",
    "enter",
    "go_home",
    "leave",
    "leave_home",
    "start",
    "transition",
)

_LOG = logging.getLogger("aiorts.kernel")
_ACTIVE, _ERROR, _INACTIVE = LifeCycleState.ACTIVE, LifeCycleState.ERROR, LifeCycleState.INACTIVE
_FROM = {Event.ACTIVATE: _INACTIVE, Event.DEACTIVATE: _ACTIVE, Event.RESET: _ERROR}
_PATIENCE = 5.0
"""Seconds of the kernel's clock that a context may take to let go of a component."""


@dataclass(slots=True)
class _Move:
    """One change of who is in a context, and its order; carried out by the context between two cycles."""

    context: Context
    composite: Composed
    joining: Sequence[Member]
    leaving: Sequence[Component]
    line: Sequence[Component]
    """Everybody of the composite afterwards, in order of execution."""
    commit: Callable[[], None]
    over: asyncio.Future[BaseException | None]
    begun: bool = False

    def steps(self, tell: Done) -> Steps:
        """One action."""
        self.begun = True
        context, life = self.context, self.context._life

        def done(error: BaseException | None) -> None:
            context._require_kernel()._on_loop(lambda: self.over.set_result(error))
            tell(error)

        try:
            for member in self.joining:
                context._check_may_join(member.component)
        except StateError as error:
            done(error)
            return
        active = any(m.active for part in self.composite.parts for m in part._rt_members if m.context is context)
        joined: list[Member] = []
        failure: BaseException | None = None
        for member in self.joining:
            joined.append(member)
            context._attach(member)
            context._publish(MemberAdded(context.name, member.component.name))
            yield from life.start(member)
            if active and member.failure is None:
                yield from life._activate(member)
            failure = member.failure
            if failure is not None:
                break
        if failure is not None:
            for member in reversed(joined):
                yield from self._let_go(member)
            name = joined[-1].component.name
            told = ComponentError(f"{self.composite.name}: {name} could not join: {said(failure)}; nothing was changed")
            told.__cause__ = failure
            done(told)
            return
        for component in reversed(self.leaving):
            for member in tuple(component._rt_members):
                if member.context is context:
                    yield from self._let_go(member)
        self.commit()
        arrange(context, self.line)
        lanes.lay_lanes(context)
        done(None)

    def _let_go(self, member: Member) -> Steps:
        yield from self.context._life._leave(member)
        self.context._detach(member)
        self.context._publish(MemberRemoved(self.context.name, member.component.name))


# -- changes -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a composite is to be; None is as it was."""

    members: Sequence[Component | str] | None = None
    rules: Sequence[Export] | None = None
    order: str | None = None
    groups: str | Sequence[Sequence[str]] | None = None
    adding: Sequence[Component | str] = ()
    removing: Sequence[str] = ()
    """Names."""

    def given(self, composite: Composed) -> Sequence[Component | str]:
        """The members it is to have, asked when its turn has come: another change may have been made meanwhile."""
        members = composite._rt_direct if self.members is None else self.members
        here = [member.name for member in composite._rt_direct]
        for name in self.removing:
            if name not in here:
                raise StateError(f"{name}: is no member of {composite.name}; it has {', '.join(here) or 'none'}")
        kept = [
            one for one in members if (one if isinstance(one, str) else getattr(one, "name", "")) not in self.removing
        ]
        return [*kept, *self.adding]


async def change(composite: Composed, wanted: Wanted, timeout: float | None) -> tuple[Connector, ...]:
    """See `Composite.change`. Once begun it goes on though the caller is cancelled."""
    kernel = composite.kernel
    kernel._check_mine(composite, "change")
    given = wanted.given(composite)
    concerned = composition_check.resolved(kernel, composite, given)
    contexts = {context for component in (composite, *concerned) for context in component.contexts}
    queued = any(context._inside() for context in contexts)
    task = kernel_task(kernel.loop, _change(composite, wanted, timeout), f"aiorts change {composite.name}")
    task.add_done_callback(_log_error if queued else _retrieve)
    return () if queued else await asyncio.shield(task)


async def _change(composite: Composed, wanted: Wanted, timeout: float | None) -> tuple[Connector, ...]:
    kernel = composite.kernel
    async with kernel._roster.composing:
        kernel._check_mine(composite, "change")
        given = wanted.given(composite)
        after = composition_check.resolved(kernel, composite, given)
        composition_check.check(composite, after, wanted.rules)
        groups = composition_check.grouped(composite, after, wanted.groups)
        order = wanted.order or composite.order
        before = composite._rt_direct
        inside = frozenset(port for part in _leaves_of(before) for port in part.ports.values())
        joining = [component for component in after if component not in before]
        leaving = [component for component in before if component not in after]
        for component in joining:
            component._rt_composite = composite
        context = composite._rt_running_context

        def commit() -> None:
            composite.order, composite._rt_groups, composite._rt_direct = order, groups, tuple(after)
            composite._rt_root._rt_lay_out()

        try:
            if context is not None:
                lanes.check_groups(composite.name, groups, context)
                line = composite._rt_line(composite._rt_ordered(after, order, groups))
                await _move(context, composite, line, commit, timeout)
        except BaseException:
            for component in joining:
                component._rt_composite = None
            for component in reversed(_leaves_of(joining)):
                await go_home(component, timeout)
            raise
        for component in leaving:
            component._rt_composite = None
        commit()
        if wanted.rules is not None:
            composite._rt_rules = tuple(wanted.rules)
        ended = composite._rt_take(after, inside)
        composite._rt_told(joining, leaving, ended)
        for component in reversed(_leaves_of(leaving)):
            await go_home(component, timeout)
        composite._rt_tell_state()
        return ended


async def _move(
    context: Context,
    composite: Composed,
    line: Sequence[Component],
    commit: Callable[[], None],
    timeout: float | None,
) -> None:
    """From now on the parts of the composite are these, in this order."""
    now = composite.parts
    joining = [part for part in line if part not in now]
    leaving = [part for part in now if part not in line]
    whole = composite._rt_root.parts
    before = whole[: whole.index(now[0])] if now else whole
    rest = [part for part in whole[len(before) :] if part not in now]
    await _carry_out(context, composite, joining, leaving, [*before, *line, *rest], commit, timeout)


async def _carry_out(
    context: Context,
    composite: Composed,
    joining: Sequence[Component],
    leaving: Sequence[Component],
    line: Sequence[Component],
    commit: Callable[[], None],
    timeout: float | None,
) -> None:
    for component in joining:
        await leave_home(component, timeout)
        context._check_may_join(component)
    over: asyncio.Future[BaseException | None] = context._require_kernel().loop.create_future()
    move = _Move(context, composite, [context._new_member(c) for c in joining], leaving, line, commit, over)
    try:
        await context._ask([(f"change {composite.name}", move.steps)], timeout)
    except TransitionTimeout:
        # What has begun is seen to its end: undone halfway, somebody would run in two contexts.
        driver = context._driver
        if not move.begun or driver is None:
            raise
        either: list[asyncio.Future[Any]] = [over, driver.ended]
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        error = over.result() if over.done() else StateError(f"{context.name}: stopped meanwhile")
        if error is not None:
            raise error from None


# -- contexts ------------------------------------------------------------------------------------------------------


async def start(kernel: Kernel, context: Context, components: Sequence[Component], *, activate: bool) -> None:
    """Start a context with composites among its components; if that fails their parts are where they were."""
    async with kernel._roster.composing:
        composites = [component for component in components if is_composite(component)]
        composition_check.check_startable(composites)
        parts: list[Component] = []
        for composite in composites:
            composite._rt_lay_out()
            lanes.check_groups(composite.name, composite._rt_sections(), context)
        for composite in composites:
            composite._rt_enter(context)
            parts += composite._rt_unfold()
        try:
            for part in parts:
                await leave_home(part, _PATIENCE)
            context._sections = tuple(section for composite in composites for section in composite._rt_sections())
            await context._start(kernel, unfolded(components), activate=activate)
        except BaseException:
            if context._driver is None:
                for member in tuple(reversed(context._members)):
                    context._detach(member)
                for composite in composites:
                    composite._rt_enter(None)
                for part in reversed(parts):
                    await go_home(part, _PATIENCE)
            raise


async def enter(context: Context, given: Sequence[Component], timeout: float | None) -> None:
    """Composites join a running context, one after the other, as `Context.add`."""
    kernel = context._check("add")
    async with kernel._roster.composing:
        for component in given:
            kernel._check_mine(component, "add")
            if not is_composite(component):
                await context.add(component, timeout=timeout)
                continue
            composition_check.check_startable([component])
            component._rt_lay_out()
            lanes.check_groups(component.name, component._rt_sections(), context)
            component._rt_enter(context)
            line = component._rt_unfold()
            try:
                await _carry_out(context, component, line, (), line, lambda: None, timeout)
            except BaseException:
                component._rt_enter(None)
                for part in reversed(line):
                    await go_home(part, timeout)
                raise


async def leave(context: Context, given: Sequence[Component], timeout: float | None) -> None:
    """Composites leave a running context, as `Context.remove`; their parts stay without one."""
    kernel = context._check("remove")
    async with kernel._roster.composing:
        for component in given:
            members = [context._member(part) for part in component._rt_unfold()]
            await context._ask([context._requests.leaving(member) for member in reversed(members)], timeout)
            if is_composite(component):
                component._rt_enter(None)
        lanes.lay_lanes(context)


# -- life cycle ----------------------------------------------------------------------------------------------------


async def transition(composite: Composed, event: Event, timeout: float | None) -> None:
    """All of a composite's members, in one action between two cycles."""
    context = composite.context
    context._check(event.value)
    await context._ask(
        [(f"{event} {composite.name}", lambda done: _transition(composite, context, event, done))], timeout
    )


def _transition(composite: Composed, context: Context, event: Event, done: Done) -> Steps:
    members = [m for part in composite.parts for m in part._rt_members if m.context is context]
    stops = composite.errors is ErrorPolicy.STOP
    if event is Event.ACTIVATE and stops and composite.state is _ERROR:
        done(StateError(f"{composite.name} in {context.name}: cannot activate from error; reset it first"))
        return
    if event is Event.DEACTIVATE:
        members.reverse()
        for member in members:
            member.stopped_for = frozenset()  # from now on they are off because somebody wants it
    told: list[BaseException] = []
    begun: list[Member] = []
    for member in members:
        if member.state is not _FROM[event]:
            continue
        outcome: list[BaseException | None] = []
        yield from context._life.request(member, event, outcome.append)
        begun.append(member)
        if outcome and outcome[0] is not None:
            told.append(outcome[0])
            if event is Event.ACTIVATE and stops:
                break
    if told and event is Event.ACTIVATE and stops:
        yield from _deactivate(reversed(begun))
    done(told[0] if told else None)


def _deactivate(members: Iterable[Member]) -> Steps:
    for member in tuple(members):
        if member.active and not member.left:
            yield from member.context._life._deactivate(member)


# -- for the log -----------------------------------------------------------------------------------------------------


def _leaves_of(components: Sequence[Component]) -> tuple[Component, ...]:
    return tuple(leaf for component in components for leaf in component._rt_leaves())


def _retrieve(task: asyncio.Task[Any]) -> None:
    if not task.cancelled():
        task.exception()


def _log_error(task: asyncio.Task[Any]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        _LOG.warning("queued %s failed: %s", task.get_name().removeprefix("aiorts "), error)
