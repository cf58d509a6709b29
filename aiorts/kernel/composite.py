"""A composite: components that are one component to everybody else, and stay what they are.

It is never run itself: given to a context it stands for its members, in their order, so that a cycle costs what it
would without it. A port it shows is the member's very port. Its state follows from theirs (`model/composition.py`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from aiorts.errors import ConfigurationError, DeclarationError, StateError, said
from aiorts.kernel import membership
from aiorts.kernel.component import Component
from aiorts.kernel.composed import Composed, CompositeChanged
from aiorts.kernel.hooks import HookKind
from aiorts.model.composition import ErrorPolicy, exports
from aiorts.model.lifecycle import Event as LifeEvent
from aiorts.model.lifecycle import LifeCycleState
from aiorts.model.profile import ComponentProfile

if TYPE_CHECKING:
    from aiorts.kernel.connector import Connector
    from aiorts.kernel.context import Context

__all__ = ("Composite", "CompositeChanged")

_OWN_HOOKS = {"on_initialize", "on_finalize"}
_REDEFINED = frozenset(
    {"add_port", "context", "contexts", "has_finished", "last_error", "profile", "remove_port", "state", "states"}
)


class Composite(Composed, _rt_redefines=_REDEFINED):
    """Components that are seen as one: `await kernel.add(Composite("arm", sensor, pid, exported=["pid.command"]))`.

    Members that belong to no kernel yet are added with it, all or none. Started in a context it stands for its
    members: they leave the contexts they are in and come back to them when they leave the composite.

    Args:
        name: the instance's name.
        members: components, other composites, or names of components that the kernel has.
        exported: ports to show: `["arm.force"]`, or patterns and names, `{"*.command": "{component}_command"}`.
        order: "stated", or "dataflow": writers before their readers, laid out at each start and change.
        groups: "a,b|c,d": what `|` parts runs side by side in each cycle, each group one member after the other; the
            cycle ends when all groups have. For members that wait for something in their hooks.
        errors: "stop", "report" or "isolate": see `ErrorPolicy`.
        own_schedule: inside another composite it is not run with it: it is started in a context of its own.

    Raises:
        ConfigurationError: an argument cannot be read.
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
        self.order = order
        self.errors = ErrorPolicy(errors)
        self.own_schedule = own_schedule
        self._rt_rules = exports(exported, self.name)
        self._rt_given, self._rt_groups_given = members, groups

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for hook, kind in cls._rt_hook_kinds.items():
            if kind != HookKind.ABSENT and hook not in _OWN_HOOKS:
                raise DeclarationError(
                    f"{cls.__qualname__}.{hook}: a composite is not run itself; write a component and make it a member"
                )
        if cls._rt_port_declarations:
            raise DeclarationError(
                f"{cls.__qualname__}.{next(iter(cls._rt_port_declarations))}: a composite has its members' ports only"
            )

    # -- what it is made of ----------------------------------------------------------------------------------------

    @property
    def members(self) -> tuple[Component, ...]:
        """The members, in the order stated; a composite among them is one."""
        return self._rt_direct

    @property
    def groups(self) -> tuple[tuple[str, ...], ...]:
        """The names of members in the groups that run side by side; empty where all run in turn."""
        return self._rt_groups

    @property
    def context(self) -> Context:
        """The context that runs its members; StateError when there is none."""
        context = self._rt_running_context
        if context is None:
            raise StateError(f"{self.name}: is in no context; await kernel.start(context, {self.name})")
        return context

    @property
    def contexts(self) -> tuple[Context, ...]:
        """The context that runs its members, if it runs."""
        context = self._rt_running_context
        return () if context is None else (context,)

    @property
    def state(self) -> LifeCycleState | None:
        """What follows from the states of its members (`aiorts.model.composition.STATES`); None in no context."""
        context = self._rt_running_context
        return None if context is None else self._rt_state_in(context)

    @property
    def states(self) -> Mapping[str, LifeCycleState]:
        """Its state, by the name of its context."""
        state = self.state
        return MappingProxyType({} if state is None else {self.context.name: state})

    @property
    def has_finished(self) -> bool:
        """Whether all its members have finished."""
        parts = self.parts
        return bool(parts) and all(part.has_finished for part in parts)

    @property
    def last_error(self) -> BaseException | None:
        """The error of the first member that is in error; else what its own `on_initialize` or `on_finalize` raised."""
        for part in self.parts:
            for member in part._rt_members:
                if member.state is LifeCycleState.ERROR and member.failure is not None:
                    return member.failure
        return self._rt_last_error

    @property
    def profile(self) -> ComponentProfile:
        """What it is at this moment, frozen; ports under the names they are exported as."""
        error = self.last_error
        return ComponentProfile(
            self.name,
            type(self).__name__,
            tuple(replace(port.profile, name=name) for name, port in self.ports.items()),
            MappingProxyType(self._rt_params.values_in_force),
            MappingProxyType({name: state.value for name, state in self.states.items()}),
            None if error is None else said(error),
            tuple(member.name for member in self._rt_laid_out),
        )

    def add_port(self, name: str, port: Any) -> Any:
        """StateError: it has its members' ports only."""
        raise StateError(f"{self.name}.{name}: a composite has its members' ports only; export one")

    def remove_port(self, name: str) -> None:
        """StateError: ports come and go with members and `change(exported=...)`."""
        raise StateError(f"{self.name}.{name}: a composite shows its members' ports; change(exported=...)")

    # -- life cycle ------------------------------------------------------------------------------------------------

    async def activate(self, *, timeout: float | None = 5.0) -> None:
        """Activate every inactive member, in order, between two cycles.

        With errors="stop" it is all or none: those that were activated before one that fails are deactivated again.

        Raises:
            StateError: it is in no context. ComponentError: an `on_activated` raised. TransitionTimeout.
        """
        await membership.transition(self, LifeEvent.ACTIVATE, timeout)

    async def deactivate(self, *, timeout: float | None = 5.0) -> None:
        """Deactivate every active member, in reverse order, as `activate`."""
        await membership.transition(self, LifeEvent.DEACTIVATE, timeout)

    async def reset(self, *, timeout: float | None = 5.0) -> None:
        """Take every member that is in error out of it, as `activate`."""
        await membership.transition(self, LifeEvent.RESET, timeout)

    # -- membership ------------------------------------------------------------------------------------------------

    async def add_members(self, *members: Component | str, timeout: float | None = 5.0) -> None:
        """More members, at the end of the order: see `change`."""
        await membership.change(self, membership.Wanted(adding=members), timeout)

    async def remove_members(self, *members: Component | str, timeout: float | None = 5.0) -> tuple[Connector, ...]:
        """Fewer members: see `change`. StateError when one is not a member."""
        leaving = [member if isinstance(member, str) else getattr(member, "name", repr(member)) for member in members]
        return await membership.change(self, membership.Wanted(removing=leaving), timeout)

    async def change(
        self,
        *,
        members: Sequence[Component | str] | None = None,
        exported: Mapping[str, str] | Iterable[str] | None = None,
        order: str | None = None,
        groups: str | Sequence[Sequence[str]] | None = None,
        timeout: float | None = 5.0,
    ) -> tuple[Connector, ...]:
        """Other members, exported ports or order: all of it between two cycles, or nothing of it.

        Who joins leaves its own contexts, and is activated when the composite is active; who leaves goes back to them.
        The ports of who leaves are withdrawn: connectors that came while they were exported and lead out of the
        composite end. Asked for by a hook it is queued and returns at once.

        Returns:
            The connectors that ended; each keeps its counts.

        Raises:
            StateError: a component is unknown, in another composite, or cannot run in the context.
            WiringError: two exported ports would have one name, or a port named is not there.
            ComponentError: `on_startup` or `on_activated` of one that joins raised; everybody is where he was.
            TransitionTimeout: the context did not come to it within `timeout` seconds.
        """
        if order is not None and order not in ("stated", "dataflow"):
            raise ConfigurationError(f"{self.name}: order = {order!r}: expected stated or dataflow")
        rules = None if exported is None else exports(exported, self.name)
        if members is not None and (isinstance(members, str) or not isinstance(members, Sequence)):
            raise DeclarationError(f"{self.name}: members = {members!r:.80}: expected a list of components or names")
        return await membership.change(self, membership.Wanted(members, rules, order, groups), timeout)
