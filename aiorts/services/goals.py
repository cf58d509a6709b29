"""A goal: work that one component has accepted from another, with feedback on its way and exactly one end.

One object serves both sides. The provider makes it, returns it from a method that is annotated
`-> Goal[Feedback, Result]`, and advances it from its hooks, in whatever thread they run; the client awaits it on the
kernel's loop. This file decides which end is the first, and wakes waiting tasks; `goal_keeper.py` joins an accepted
goal to components and connectors.
"""

from __future__ import annotations

import asyncio
import math
from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Generic, Literal, NamedTuple, TypeAlias, TypeVar

from aiorts.errors import (
    BusyError,
    ConfigurationError,
    GoalCancelled,
    GoalFailed,
    ServiceTimeout,
    StateError,
    ThreadError,
    format_error,
)
from aiorts.kernel.loop.origins import located

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Self

    from aiorts.services.goal_keeper import Acceptance

F = TypeVar("F")
R = TypeVar("R")
GoalState: TypeAlias = Literal["offered", "running", "succeeded", "failed", "cancelled"]
_KEPT: Final = 8
"""The most feedback that waits for a client."""
_END: Final = object()
"""The mark of the goal's end among the feedback."""


class Outcome(NamedTuple):
    """The end of a goal."""

    state: GoalState
    result: Any = None
    text: str = ""
    """The reason of a failure, in words."""
    error: BaseException | None = None
    reason: str = ""
    """The key under which the failure is counted."""
    own: bool = True
    """Whether the provider ended the goal."""


class Goal(Generic[F, R]):
    """Work that a component has accepted from another: a method annotated `-> Goal[Feedback, Result]` returns it.

    The provider makes a goal with `Goal()`, keeps it, returns it, and uses `feedback`, `cancel_requested`, `succeed`,
    `fail` and `cancelled`. The client uses `async for`, `result`, `cancel` and `state`.

    The first end counts. When the goal was ended from outside (its provider was deactivated, or did not cancel it in
    time), further steps of the provider are ignored, so that it needs no check before each step.
    """

    __slots__ = (
        *("_chance", "_acceptance", "_doings", "_feedback", "_outcome", "_over"),
        *("_reader", "_requested", "_waiters", "on_cancel"),
    )

    def __init__(self) -> None:
        self._acceptance: Acceptance | None = None
        """The goal's acceptance; None before."""
        self._chance = [True]
        """A list with one item, which the first end of the goal removes, from any thread."""
        self._outcome: Outcome | None = None
        self._doings: deque[tuple[Any, bool]] = deque()
        """Feedback, and the end, on their way to the loop; each with whether its type was checked."""
        self._feedback: deque[F] = deque()
        """Feedback that the client has not read."""
        self._over = False
        """Whether the end has come to the loop."""
        self._requested = ""
        """The reason why the goal is to be cancelled; "" while it is not."""
        self._reader: asyncio.Future[None] | None = None
        self._waiters: list[asyncio.Future[None]] = []
        self.on_cancel: Callable[[], object] | None = None
        """The provider's function that is called on the loop when the goal is to be cancelled."""

    @property
    def state(self) -> GoalState:
        """ "offered" until the method has returned it, "running", then "succeeded", "failed" or "cancelled"."""
        outcome = self._outcome
        if outcome is not None:
            return outcome.state
        return "offered" if self._acceptance is None else "running"

    def __repr__(self) -> str:
        return f"<Goal {self._name} {self.state}>"

    # -- for the client --------------------------------------------------------------------------------------------

    def __aiter__(self) -> Self:
        """Iterate over the feedback, as it comes, until the goal ends: `async for progress in goal`. For one task.

        The newest eight wait for a client that is slow. A task that is cancelled while it waits here asks to cancel the
        goal.
        """
        return self

    async def __anext__(self) -> F:
        acceptance = self._awaitable("its feedback")
        while not self._feedback:
            if self._over:
                raise StopAsyncIteration
            if self._reader is not None:
                raise BusyError(f"{self._name}: another task waits for its feedback; one task reads it")
            self._reader = acceptance.kernel.loop.create_future()
            try:
                await self._reader
            except asyncio.CancelledError:
                self._request("its client was cancelled")
                raise
            finally:
                self._reader = None
        return self._feedback.popleft()

    async def result(self, timeout: float | None = None) -> R:
        """Wait for the end of the goal; returns its result.

        A client that gives up asks to cancel the goal: by `timeout`, or as a task that is cancelled while it waits.
        `result` can then be awaited again, for the end of the goal.

        Args:
            timeout: the most seconds of the kernel's clock to wait; None waits until the end.

        Raises:
            GoalFailed: the goal has failed; `reason` and `__cause__` say why.
            GoalCancelled: the goal was cancelled on request.
            ServiceTimeout: the goal has not ended in time.
            StateError: the goal was not accepted yet.
        """
        acceptance = self._awaitable("its result")
        if timeout is not None and not (isinstance(timeout, int | float) and 0 <= timeout < math.inf):
            raise ConfigurationError(
                f"{self._name}: result: timeout = {timeout!r}: expected seconds from 0 on, or None"
            )
        if not self._over:
            ended: asyncio.Future[None] = acceptance.kernel.loop.create_future()
            self._waiters.append(ended)
            timer = None if timeout is None else acceptance.kernel.call_later(timeout, partial(_wake, ended))
            try:
                await ended
            except asyncio.CancelledError:
                self._request("its client was cancelled")
                raise
            finally:
                self._waiters.remove(ended)
                if timer is not None:
                    timer.cancel()
        outcome = self._outcome
        if not self._over or outcome is None:
            self._request(f"its client waited for {timeout} s")
            raise ServiceTimeout(
                f"{self._name}: did not end within {timeout} s; it was asked to cancel{acceptance.held_up}"
            )
        if outcome.state == "succeeded":
            result: R = outcome.result
            return result
        if outcome.state == "cancelled":
            raise GoalCancelled(f"{self._name}: was cancelled: {self._requested}")
        error = GoalFailed(f"{self._name}: failed: {outcome.text}")
        error.reason = outcome.reason
        raise error from outcome.error

    def cancel(self) -> None:
        """Ask the provider to cancel the goal within its `cancel_timeout`; `result` awaits the end. From any thread.

        Nothing happens to a goal that has ended, or was asked before.
        """
        self._accepted("be cancelled").kernel.call_on_loop(partial(self._request, "its client cancelled it"))

    # -- for the provider: in any thread ---------------------------------------------------------------------------

    @property
    def cancel_requested(self) -> bool:
        """Whether the provider should end the goal soon, by `cancelled`, or by `succeed` if the work is done by then.

        The value stays True when the goal was ended from outside. An event context executes the provider when it
        becomes True.
        """
        return self._requested != ""

    def feedback(self, value: F) -> bool:
        """Report progress to the client. Returns False where the goal was ended from outside.

        Raises:
            InterfaceMismatch: the value is of another type than the interface says.
            StateError: the provider has ended the goal.
        """
        if not self._chance:
            return self._ended_before("give feedback")
        self._do(value, self._checked("feedback", value))
        return True

    def succeed(self, result: R) -> bool:
        """End the goal with its result. Returns False where the goal was ended from outside.

        Raises:
            InterfaceMismatch: the result is of another type than the interface says; the goal goes on.
            StateError: the provider has ended the goal.
        """
        if not self._chance:
            return self._ended_before("succeed")
        return self._end("succeed", Outcome("succeeded", result), checked=self._checked("result", result))

    def fail(self, error: BaseException | str) -> bool:
        """End the goal without a result; the client gets GoalFailed with this cause. Returns False where the goal was
        ended from outside.

        Raises:
            StateError: the provider has ended the goal.
        """
        if isinstance(error, BaseException):
            return self._end("fail", Outcome("failed", None, located(error), error, "provider"))
        if not isinstance(error, str):
            raise TypeError(f"{self._name}: fail({error!r:.80}): expected an exception or a text")
        return self._end("fail", Outcome("failed", None, error, None, "provider"))

    def cancelled(self) -> bool:
        """End the goal as cancelled, on request. Returns False where the goal was ended from outside.

        Raises:
            StateError: the client did not ask to cancel the goal, or the provider has ended the goal.
        """
        if not self._requested:
            raise StateError(
                f"{self._name}: its client did not ask to cancel it (cancel_requested); end it with fail(...)"
            )
        return self._end("be cancelled", Outcome("cancelled"))

    def _end(self, what: str, outcome: Outcome, *, checked: bool = True) -> bool:
        if not self._claim():
            return self._ended_before(what)
        self._outcome = outcome
        self._do(_END, checked)
        return True

    def _ended_before(self, what: str) -> bool:
        outcome = self._outcome
        if outcome is not None and outcome.own:
            raise StateError(f"{self._name}: cannot {what}: its provider has ended it, it is {outcome.state}")
        return False

    def _checked(self, what: str, value: object) -> bool:
        """Whether the value's type could be checked by now; InterfaceMismatch: the value is of another type."""
        acceptance = self._acceptance
        if acceptance is None:
            return False
        wrong = acceptance.misfit(what, value)
        if wrong is not None:
            raise wrong
        return True

    def _do(self, doing: object, checked: bool) -> None:
        self._doings.append((doing, checked))
        # Append first, then look at the acceptance: `_accept` sets that first, and then looks at `_doings`.
        if self._acceptance is not None:
            self._acceptance.kernel.call_on_loop(self._catch_up)

    def _claim(self) -> bool:
        """Claim the end of the goal; whether this is the first claim."""
        try:
            return self._chance.pop()
        except IndexError:
            return False

    # -- on the loop -----------------------------------------------------------------------------------------------

    def _accept(self, acceptance: Acceptance) -> None:
        """Let the goal run from now on; earlier steps of the provider come to the client now."""
        self._acceptance = acceptance
        self._catch_up()

    def _catch_up(self) -> None:
        """Hand the steps of the provider to the client, in their order."""
        acceptance = self._acceptance
        while self._doings and acceptance is not None:
            doing, checked = self._doings.popleft()
            if doing is not _END:
                self._take_feedback(acceptance, doing, checked)
                continue
            outcome = self._outcome
            if not checked and outcome is not None:
                self._outcome = outcome = _judged(outcome, acceptance.misfit("result", outcome.result))
            self._over = True
            for waiter in (self._reader, *self._waiters):
                _wake(waiter)
            acceptance.ended(self, outcome or Outcome("failed"))

    def _take_feedback(self, acceptance: Acceptance, value: Any, checked: bool) -> None:
        acceptance.count("feedback")
        wrong = None if checked else acceptance.misfit("feedback", value)
        if wrong is not None or self._over:
            acceptance.count("dropped")
            if wrong is not None:
                self._end_from_outside("mismatch", format_error(wrong), wrong)
            return
        self._feedback.append(value)
        if len(self._feedback) > _KEPT:
            self._feedback.popleft()
            acceptance.count("dropped")
        _wake(self._reader)

    def _end_from_outside(self, reason: str, text: str, error: BaseException | None = None) -> None:
        """Fail the goal, unless it has ended already; further steps of its provider are ignored."""
        if not self._claim():
            return
        self._outcome = Outcome("failed", None, text, error, reason, own=False)
        self._requested = self._requested or text
        self._do(_END, checked=True)

    def _request(self, why: str) -> None:
        """Ask the provider to cancel the goal."""
        if self._chance and not self._requested and self._acceptance is not None:
            self._requested = why
            self._acceptance.requested(self)
            if self.on_cancel is not None:
                self.on_cancel()

    # -- what can be done now --------------------------------------------------------------------------------------

    @property
    def _name(self) -> str:
        return "a goal that was not accepted" if self._acceptance is None else self._acceptance.name

    def _accepted(self, what: str) -> Acceptance:
        if self._acceptance is None:
            raise StateError(
                f"a goal cannot {what} before it is accepted: the method has to return it, and the interface to be "
                "annotated `-> Goal[Feedback, Result]` with names that can be resolved"
            )
        return self._acceptance

    def _awaitable(self, what: str) -> Acceptance:
        acceptance = self._accepted("be waited for")
        if not acceptance.kernel.on_loop_thread():
            raise ThreadError(
                f"{self._name}: {what} is awaited on the kernel's loop; in the thread of a ThreadContext look at "
                "`state`, or use call_blocking with a function that awaits it"
            )
        return acceptance


def _judged(outcome: Outcome, wrong: BaseException | None) -> Outcome:
    """An outcome whose result was checked only now: a failure where the result is wrong."""
    return outcome if wrong is None else Outcome("failed", None, format_error(wrong), wrong, "mismatch")


def _wake(waiter: asyncio.Future[None] | None) -> None:
    if waiter is not None and not waiter.done():
        waiter.set_result(None)
