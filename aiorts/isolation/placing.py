"""The context of a component that runs in a process of its own: it stands for the context that runs there."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.clock import to_ns
from aiorts.errors import StateError
from aiorts.kernel.execution.context import Context
from aiorts.kernel.execution.cycle import Wait
from aiorts.model.lifecycle import OverdueHook
from aiorts.model.profile import ContextStatistics, HookStatistics

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.execution.cell import ComponentSide

_MISSING: Final = object()


class RemoteContext(Context):
    """Stands for a context that runs in the process of its one member. It runs no cycles itself.

    Args:
        given: the context as it was made for `Kernel.start`; it is started in the process.
    """

    exclusive = True

    def __init__(self, given: Context) -> None:
        super().__init__(name=given.name)  # a deadline is for the hooks there, not for those that ask for them
        self.given = given
        """The context that it stands for; it never runs here."""
        self.kind = given.kind  # type: ignore[misc] # that of the one it stands for
        self._rate = given.rate
        self._there = ContextStatistics(0)
        self._late: OverdueHook | None = None
        """The hook that is over its deadline there."""
        self._late_ns = 0
        """The time at which the process reported that hook."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name in ("given", "name"):
            raise AttributeError(name)
        raise AttributeError(f"{self.name}.{name}: this context runs in the process of its member", name=name, obj=self)

    @property
    def rate(self) -> float | None:
        return self._rate

    async def set_rate(self, rate: float, timeout: float | None = 5.0) -> None:
        """Set another rate from the next cycle on. Errors as those of the context that it stands for."""
        before, self._rate = self._rate, rate
        try:
            for member in self.members:
                await member.on_rate_changed()  # type: ignore[attr-defined] # a stand-in
        except BaseException:
            self._rate = before
            raise

    @property
    def counts(self) -> ContextStatistics:
        """The last counts of its process, which reports twice a second; a new process counts from 0."""
        return replace(self._there, hooks={}, at_ns=super().counts.at_ns)

    def counted(self, statistics: ContextStatistics, overdue: OverdueHook | None) -> None:
        """Take a report of the process: the counts of the context there, and the hook that is over its deadline."""
        self._there, self.ticks = statistics, statistics.cycles
        self._late, self._late_ns = overdue, self.runner.kernel.clock.monotonic_ns()

    def _overdue(self, member: Any) -> OverdueHook | None:
        process = member.component._process
        if process is None or not process.runs:
            return None
        if process.busy:
            deadline = process.deadline
            if deadline is None or process.busy <= deadline:
                return None
            return OverdueHook("", to_ns(process.busy), to_ns(deadline))
        passed_ns = self.runner.kernel.clock.monotonic_ns() - self._late_ns
        late = self._late
        return None if late is None else replace(late, running_ns=late.running_ns + passed_ns)

    def _hook_statistics(self) -> Mapping[str, HookStatistics]:
        return self._there.hooks

    def as_started(self) -> dict[str, Any]:
        """The arguments that start it in the process: name, kind and options."""
        given, options = self.given, {}
        for argument, parameter in inspect.signature(type(given)).parameters.items():
            value = getattr(given, argument, _MISSING)
            if argument != "name" and value is not _MISSING and value != parameter.default:
                options[argument] = value
        if self._rate is not None:
            options["rate"] = self._rate
        return {"name": self.name, "kind": self.kind, "options": options}

    def _next_cause(self) -> Wait | None:
        return Wait(None)

    def _check_can_add(self, component: ComponentSide) -> None:
        super()._check_can_add(component)
        if not hasattr(type(component), "original"):
            raise StateError(f"{component.name}: is in this process, and {self.name} runs in another")
        if self._members:
            raise _two(self._members[0].component, component)


def given_of(context: Context) -> Context:
    """The context as it was given to `Kernel.start`, wherever it runs."""
    return context.given if isinstance(context, RemoteContext) else context


def placed(context: Context, components: Sequence[Component]) -> Context:
    """The context to start with these components: another one, where they run in a process of their own.

    Raises:
        StateError: they run in different processes.
    """
    remote = [one for one in components if hasattr(type(one), "original")]
    if not remote:
        return context
    if len(components) > 1:
        raise _two(remote[0], next(one for one in components if one is not remote[0]))
    return context if isinstance(context, RemoteContext) else RemoteContext(context)


def _two(one: ComponentSide, other: ComponentSide) -> StateError:
    where = "in another" if hasattr(type(other), "original") else "in that of its kernel"
    return StateError(
        f"{one.name} runs in a process of its own, and {other.name} {where}: a context runs where its members are; "
        "start one for each"
    )
