"""Activates components one after the other by their rules, and deactivates them in the reverse order."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from aiorts.errors import AiortsError, StateError, TransitionTimeout
from aiorts.model.lifecycle import LifecycleState
from aiorts.model.wanted.start_rules import ADDED, Condition, StartRule, in_order
from aiorts.supervision.readiness import until

if TYPE_CHECKING:
    from aiorts.kernel.component import Component
    from aiorts.kernel.microkernel import Microkernel


class Patience:
    """How long the rules of one start may still wait.

    A rule also waits while the components that its conditions name are activated, before its turn comes.
    """

    def __init__(self, kernel: Microkernel, rules: Iterable[StartRule]) -> None:
        self._kernel, self._rules = kernel, tuple(rules)
        self._spent: Counter[str] = Counter()
        """Nanoseconds, by the component of the rule."""

    def left(self, rule: StartRule) -> float:
        """Seconds that the conditions of this rule may still take."""
        return max(0.0, rule.timeout - self._spent[rule.component] / 1e9)

    @asynccontextmanager
    async def activating(self, *names: str) -> AsyncIterator[None]:
        """A context manager around the activation of these components.

        Raises:
            TransitionTimeout: a rule has waited for a component as long as it may; the activation is waited for no
                longer.
        """
        waiting = [
            rule
            for rule in self._rules
            if any(one.component in names and not _holds(self._kernel, one) for one in rule.conditions)
        ]
        if not waiting:
            yield
            return
        kernel, first = self._kernel, min(waiting, key=self.left)
        begun = kernel.clock.monotonic_ns()
        limit = asyncio.timeout(None)
        try:
            async with limit:
                timer = kernel.call_later(self.left(first), lambda: limit.reschedule(kernel.loop.time()))
                try:
                    yield
                finally:
                    timer.cancel()
        except TimeoutError:
            if not limit.expired():
                raise
            raise not_started(kernel, first) from None
        finally:
            took = kernel.clock.monotonic_ns() - begun
            self._spent.update({rule.component: took for rule in waiting})


async def start_in_order(
    kernel: Microkernel, rules: Sequence[StartRule], started: list[str], patience: Patience
) -> None:
    """See `Kernel.start_in_order`; adds the name of each that was activated to `started`."""
    for rule in in_order(rules):
        conditions = rule.conditions
        # All conditions are checked together: a condition that was true a while ago does not count.
        if not await until(kernel, lambda cs=conditions: all(_holds(kernel, c) for c in cs), patience.left(rule)):  # type: ignore[misc]
            raise not_started(kernel, rule)
        if rule.wait:
            await kernel.sleep(rule.wait)
        component = kernel.components.get(rule.component)
        if component is None:
            there = ", ".join(kernel.components) or "none"
            raise StateError(f"{rule.component}: cannot be started: no such component; there are {there}")
        if not component.contexts:
            raise StateError(f"{rule.component}: cannot be started: it is in no context")
        if rule.component not in started:
            started.append(rule.component)
        async with patience.activating(rule.component):
            await _activate(component)


def not_started(kernel: Microkernel, rule: StartRule) -> TransitionTimeout:
    """The error of a rule whose conditions have taken too long."""
    untrue = "; ".join(_text(kernel, one) for one in rule.conditions if not _holds(kernel, one))
    return TransitionTimeout(f"{rule.component}: not started: after {rule.timeout} s still {untrue}")


async def _activate(component: Component) -> None:
    for context in component.contexts:
        if context.state(component) is not LifecycleState.ACTIVE:
            await context.activate(component)


async def stop_in_order(kernel: Microkernel, names: Sequence[str], timeout: float | None = 5.0) -> None:
    """Deactivate components in the reverse order, each before the next; a failure does not stop the others.

    Raises the error of the first component that could not be deactivated.
    """
    first: AiortsError | None = None
    for name in reversed(names):
        component = kernel.components.get(name)
        for context in () if component is None else component.contexts:
            if component is not None and context.running and context.state(component) is LifecycleState.ACTIVE:
                try:
                    await context.deactivate(component, timeout=timeout)
                except AiortsError as error:
                    first = first or error
    if first is not None:
        raise first


def _holds(kernel: Microkernel, condition: Condition) -> bool:
    component = kernel.components.get(condition.component)
    if component is None:
        return False
    states = component.states.values()
    return condition.state == ADDED or (bool(states) and all(state.value == condition.state for state in states))


def _text(kernel: Microkernel, condition: Condition) -> str:
    component = kernel.components.get(condition.component)
    if component is None:
        return f"not {condition}: it is not there"
    states = ", ".join(str(state) for state in component.states.values()) or "in no context"
    return f"not {condition}: it is {states}"
