"""A composite: components that are one component from outside.

A composite never runs itself: in a context it stands for its members, in their order, so that a cycle costs what it
would without the composite. An exported port is the member's own port. The composite's state follows from its members'
(`composites/composition.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, cast

from aiorts.composites import membership
from aiorts.composites.composition import exports
from aiorts.composites.group import CompositeChanged, CompositeGroup, CompositeKind
from aiorts.errors import ConfigurationError, DeclarationError, StateError, format_error
from aiorts.kernel.component import Component
from aiorts.kernel.declarations import declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.hooks import HookKind
from aiorts.model.lifecycle import OUTSIDE, LifecycleState
from aiorts.model.lifecycle import Event as LifeEvent
from aiorts.model.policy import ErrorPolicy
from aiorts.model.profile import ComponentProfile

if TYPE_CHECKING:
    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.ports.connector import Connector

__all__ = ("Composite", "CompositeChanged")

_REDEFINED = frozenset(
    {"add_port", "context", "contexts", "has_finished", "last_error", "profile", "remove_port", "state", "states"}
)


class Composite(Component, kind=CompositeKind(), redefines=_REDEFINED):
    """Components that look like one: `await kernel.add(Composite("arm", sensor, pid, exported=["pid.command"]))`.

    Members that belong to no kernel yet are added with it, all or none. Started in a context it stands for its members:
    they leave the contexts they are in, and return to them when they leave the composite.

    Args:
        name: the instance's name.
        members: components, other composites, or names of components that the kernel has.
        exported: ports to export: `["arm.force"]`, or patterns and names, `{"*.command": "{component}_command"}`.
        order: "stated", or "dataflow": writers before their readers, laid out at each start and change.
        groups: "a,b|c,d": groups separated by `|` run side by side in each cycle, each group one member after the
            other; the cycle ends when all groups have. For members whose hooks wait.
        errors: "stop", "report" or "isolate": see `ErrorPolicy`.
        own_schedule: inside another composite, it is started in a context of its own. An outer one whose members are
            all such is in no context: its state, errors and transitions are theirs together.

    Raises:
        ConfigurationError: an argument cannot be parsed.
        DeclarationError: a member is neither a component nor a name.
    """

    def __init__(
        self,
        name: str = "",
        *members: Component | str,
        exported: Mapping[str, str] | Iterable[str] = (),
        order: str = "stated",
        groups: str | Sequence[Sequence[str]] = "",
        errors: str = "stop",
        own_schedule: bool = False,
    ) -> None:
        super().__init__(name)
        if order not in ("stated", "dataflow"):
            raise ConfigurationError(f"{self.name}: order = {order!r}: expected stated or dataflow")
        if errors not in tuple(ErrorPolicy):
            raise ConfigurationError(f"{self.name}: errors = {errors!r}: expected {', '.join(ErrorPolicy)}")
        for member in members:
            if not isinstance(member, Component | str):
                raise DeclarationError(f"{self.name}: expected components or their names, got {member!r}")
        group = CompositeGroup(self, order, ErrorPolicy(errors), own_schedule=own_schedule)
        group.exports = exports(exported, self.name)
        group.given, group.groups_given = members, groups
        cell(self).stands_for = group

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for hook, kind in declarations(cls).hook_kinds.items():
            if kind != HookKind.ABSENT and hook not in OUTSIDE:
                raise DeclarationError(
                    f"{cls.__qualname__}.{hook}: a composite is not run itself; write a component and make it a member"
                )
        if declarations(cls).ports:
            raise DeclarationError(
                f"{cls.__qualname__}.{next(iter(declarations(cls).ports))}: a composite has its members' ports only"
            )

    # -- what it is made of ----------------------------------------------------------------------------------------

    @property
    def members(self) -> tuple[Component, ...]:
        """The members, in the order stated; a composite among them is one member."""
        return _group(self).members

    @property
    def parts(self) -> tuple[Component, ...]:
        """The components that run with it, in order of execution: members, and the parts of inner composites."""
        return _group(self).parts

    @property
    def order(self) -> str:
        """The order of its members: "stated" or "dataflow"."""
        return _group(self).order

    @property
    def errors(self) -> ErrorPolicy:
        """The effect of a member's error on the composite."""
        return _group(self).errors

    @property
    def own_schedule(self) -> bool:
        """Whether this composite, inside another, runs in a context of its own."""
        return _group(self).own_schedule

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The names of members in the groups that run side by side; empty when all run in turn."""
        return _group(self).groups

    @property
    def context(self) -> Context:
        """The context that runs its members; StateError when there is none."""
        context = _group(self).context
        if context is None:
            raise StateError(f"{self.name}: is in no context; await kernel.start(context, {self.name})")
        return context

    @property
    def contexts(self) -> tuple[Context, ...]:
        """The context that runs its members, if it runs."""
        context = _group(self).context
        return () if context is None else (context,)

    @property
    def state(self) -> LifecycleState | None:
        """The state that follows from its members' (`aiorts.composites.composition.STATES`); None in no context."""
        return _group(self).state

    @property
    def states(self) -> Mapping[str, LifecycleState]:
        """Its state, by the name of its context, or of each context where all members have a schedule of their own."""
        return MappingProxyType(_group(self).states)

    @property
    def has_finished(self) -> bool:
        """Whether all its members have finished."""
        parts = _group(self).parts_together
        return bool(parts) and all(part.has_finished for part in parts)

    @property
    def last_error(self) -> BaseException | None:
        """The error of the first member in error; else the error of its own `on_initialize` or `on_finalize`."""
        for part in _group(self).parts_together:
            for member in cell(part).members:
                if member.state is LifecycleState.ERROR and member.failure is not None:
                    return member.failure
        return cell(self).last_error

    @property
    def profile(self) -> ComponentProfile:
        """Its description at this moment, frozen; ports under the names they are exported as."""
        error = self.last_error
        return ComponentProfile(
            self.name,
            type(self).__name__,
            tuple(replace(port.profile, name=name) for name, port in self.ports.items()),
            cell(self).configuration.values,
            MappingProxyType({name: state.value for name, state in self.states.items()}),
            None if error is None else format_error(error),
            tuple(member.name for member in _group(self).laid_out),
        )

    def add_port(self, name: str, port: Any) -> Any:
        """Raise StateError: a composite has its members' ports only."""
        raise StateError(f"{self.name}.{name}: a composite has its members' ports only; export one")

    def remove_port(self, name: str) -> None:
        """Raise StateError: ports come and go with members and `change(exported=...)`."""
        raise StateError(f"{self.name}.{name}: a composite shows its members' ports; change(exported=...)")

    # -- lifecycle -------------------------------------------------------------------------------------------------

    async def activate(self, *, timeout: float | None = 5.0) -> None:
        """Activate every inactive member, in order, between two cycles.

        With errors="stop" it is all or none: members that were activated before one that fails are deactivated again.

        Raises:
            StateError: it is in no context.
            ComponentError: an `on_activated` raised. TransitionTimeout.
        """
        await membership.transition(_group(self), LifeEvent.ACTIVATE, timeout)

    async def deactivate(self, *, timeout: float | None = 5.0) -> None:
        """Deactivate every active member, in reverse order; otherwise like `activate`."""
        await membership.transition(_group(self), LifeEvent.DEACTIVATE, timeout)

    async def reset(self, *, timeout: float | None = 5.0) -> None:
        """Reset every member that is in error; otherwise like `activate`."""
        await membership.transition(_group(self), LifeEvent.RESET, timeout)

    # -- membership ------------------------------------------------------------------------------------------------

    async def add_members(self, *members: Component | str, timeout: float | None = 5.0) -> None:
        """Add members at the end of the order: see `change`."""
        await membership.change(_group(self), membership.Wanted(adding=members), timeout)

    async def remove_members(self, *members: Component | str, timeout: float | None = 5.0) -> tuple[Connector, ...]:
        """Remove members: see `change`. StateError when one is not a member."""
        leaving = [member if isinstance(member, str) else getattr(member, "name", repr(member)) for member in members]
        return await membership.change(_group(self), membership.Wanted(removing=leaving), timeout)

    async def change(
        self,
        *,
        members: Sequence[Component | str] | None = None,
        exported: Mapping[str, str] | Iterable[str] | None = None,
        order: str | None = None,
        groups: str | Sequence[Sequence[str]] | None = None,
        timeout: float | None = 5.0,
    ) -> tuple[Connector, ...]:
        """Change members, exported ports or order: all between two cycles, or nothing.

        A new member leaves its own contexts, and is activated when the composite is active; a removed one returns to
        its own. The ports of a removed member are withdrawn: connectors that lead out of the composite and were made
        while it exported them end. A hook's request is queued and returns at once.

        Returns:
            The connectors that ended; each keeps its counts.

        Raises:
            StateError: a component is unknown, in another composite, or cannot run in the context.
            WiringError: two exported ports would have one name, or a named port does not exist.
            ConfigurationError: `order`, `exported` or `groups` cannot be parsed.
            DeclarationError: `members` is no list of components or names.
            ComponentError: `on_startup` or `on_activated` of a new member raised; everything is as before.
            TransitionTimeout: the context did not carry out the change within `timeout` seconds.
        """
        if order is not None and order not in ("stated", "dataflow"):
            raise ConfigurationError(f"{self.name}: order = {order!r}: expected stated or dataflow")
        rules = None if exported is None else exports(exported, self.name)
        if members is not None and (isinstance(members, str) or not isinstance(members, Sequence)):
            raise DeclarationError(f"{self.name}: members = {members!r:.80}: expected a list of components or names")
        return await membership.change(_group(self), membership.Wanted(members, rules, order, groups), timeout)


def _group(composite: Composite) -> CompositeGroup:
    return cast("CompositeGroup", cell(composite).stands_for)
