"""Components with modes, and components that take part in another's state machine: hooks that only they have.

Both are of the RTC specification (multi-mode package; FSM participant) and are run as every hook is: by the
context, between two cycles, under its deadline, with its failures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from aiorts.errors import ComponentError, DeclarationError, StateError, said
from aiorts.kernel.bus import Event
from aiorts.kernel.component import Component, Hook
from aiorts.kernel.hooks import further_kinds
from aiorts.kernel.life import Action, Call
from aiorts.model.charting import hint
from aiorts.model.lifecycle import Failure, LifeCycleState
from aiorts.model.names import check_name

if TYPE_CHECKING:
    from aiorts.kernel.life import Done, Steps
    from aiorts.kernel.machine_events import MachineChanged
    from aiorts.kernel.member import Member
    from aiorts.kernel.state_machine import StateMachine

__all__ = ("ModeChanged", "MultiModeComponent", "Participant")

_ERROR = LifeCycleState.ERROR
_ACTIVE = LifeCycleState.ACTIVE


@dataclass(frozen=True, slots=True)
class ModeChanged(Event):
    """A component is in another mode in this context; `on_mode_changed` has run. "": it is in no context."""

    component: str
    context: str
    old: str
    new: str


class MultiModeComponent(Component):
    """A component that works in one of several modes, named in `modes`; the first is the default.

        class Arm(MultiModeComponent):
            modes = ("manual", "automatic")

            async def on_mode_changed(self) -> None:
                self.log.info("now %s", self.mode)

    A change takes place between two cycles, in each context of its own, and never waits for a tick.
    """

    modes: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if not isinstance(cls.modes, tuple | list) or len(set(cls.modes)) != len(cls.modes):
            raise DeclarationError(f"{cls.__qualname__}.modes: expected names, each once, got {cls.modes!r}")
        taken = [name for name in ("mode", "pending_mode", "modes_by_context", "default_mode") if name in vars(cls)]
        if taken:
            raise DeclarationError(f"{cls.__qualname__}.{taken[0]}: says what the mode is; choose another name")
        for mode in cls.modes:
            check_name(mode, "mode")
        cls._rt_hook_kinds |= further_kinds(cls, MultiModeComponent, {"on_mode_changed": ("self",)})

    def __init__(self, name: str = "") -> None:
        if not self.modes:
            raise DeclarationError(f'{type(self).__qualname__}: has no modes; write modes = ("manual", "automatic")')
        super().__init__(name)
        self._rt_mode = self.modes[0]
        self._rt_modes: dict[str, str] = {}
        self._rt_pending: list[str] = []
        """The mode asked for last, until it has taken effect; each request has a list of its own."""

    @property
    def default_mode(self) -> str:
        """The mode it begins in."""
        return self.modes[0]

    @property
    def mode(self) -> str:
        """The mode in the context whose hook runs; else the one asked for last that took effect somewhere."""
        running = self._rt_running
        return self._rt_mode if running is None else self._rt_modes.get(running.context.name, self._rt_mode)

    @property
    def pending_mode(self) -> str | None:
        """The mode that was asked for and has not yet taken effect in every context; None where there is none."""
        return self._rt_pending[0] if self._rt_pending else None

    @property
    def modes_by_context(self) -> Mapping[str, str]:
        """The mode in each context, by the context's name."""
        known = self._rt_modes
        return MappingProxyType({each.name: known.get(each.name, self._rt_mode) for each in self.contexts})

    async def set_mode(self, mode: str, timeout: float | None = 5.0) -> None:
        """Change the mode and have `on_mode_changed` run in every context; in its own hooks it is queued.

        In the mode it is in already nothing is run. In no context there is nobody to run the hook, and it is not run.

        Raises:
            StateError: there is no such mode, or the component is in error. ComponentError: the hook raised, and the
                component is in error. TransitionTimeout: a context did not get to it within `timeout` seconds.
        """
        if mode not in self.modes:
            raise StateError(f"{self.name}: no mode {mode!r}{hint(mode, self.modes)}")
        if self._rt_kernel is not None:
            self._rt_kernel.check_thread(f"{self.name}.set_mode")
        if any(member.state is _ERROR for member in self._rt_members):
            raise StateError(f"{self.name}: cannot change its mode in error; reset it first")
        if not self._rt_members:
            old = self._rt_mode
            self._rt_enter_mode("", mode)
            if self._rt_kernel is not None and old != mode:
                self._rt_kernel.bus.publish(ModeChanged(self.name, "", old, mode))
            return
        self._rt_pending = pending = [mode]
        try:
            for member in tuple(self._rt_members):
                await member.context._ask(
                    [(f"change mode of {self.name}", partial(self._rt_change, member, mode))], timeout
                )
        except BaseException:
            pending.clear()  # it was withdrawn: nobody waits for it
            raise

    def on_mode_changed(self) -> Hook:
        """The mode is another: `mode` says which. Raising moves the component to error; the new mode stays."""
        return None

    def _rt_enter_mode(self, context: str, mode: str) -> None:
        old = self._rt_modes.get(context, self._rt_mode)
        self._rt_mode = mode
        if context:
            # Where it has not changed yet it is still in the old one.
            for member in self._rt_members:
                self._rt_modes.setdefault(member.context.name, old)
            self._rt_modes[context] = mode
        self._rt_settle(mode)

    def _rt_settle(self, mode: str) -> None:
        """Where every context has come to this mode, none is pending."""
        if all(each == mode for each in self.modes_by_context.values()):
            self._rt_pending = []
            self._rt_modes.clear()

    def _rt_change(self, member: Member, mode: str, done: Done) -> Steps:
        context = member.context
        old = self._rt_modes.get(context.name, self._rt_mode)
        told: BaseException | None = None
        if old != mode and not member.left:
            self._rt_enter_mode(context.name, mode)
            error = yield Call(member, "on_mode_changed")
            if error is not None:
                context._life._fail(member, "on_mode_changed", error, Failure.ABORT)
                told = ComponentError(f"{self.name}: on_mode_changed raised {said(error)}")
                told.__cause__ = error
            context._publish(ModeChanged(self.name, context.name, old, mode))
        else:
            self._rt_settle(mode)
        done(told)


class Participant(Component):
    """A component that another's state machine tells of each change: `door.machine.add_participant(arm)`.

    `on_action` runs in the participant's own context, between two cycles, while it is active.
    """

    _rt_machines: tuple[StateMachine, ...] = ()
    """The machines that tell it."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls._rt_hook_kinds |= further_kinds(cls, Participant, {"on_action": ("self", "change")})

    def on_action(self, change: MachineChanged) -> Hook:
        """A machine that this component takes part in has changed its configuration."""
        return None

    def _rt_told(self, change: MachineChanged) -> None:
        """On the kernel's loop."""
        for member in self._rt_members:
            member.context._submit(Action(_telling(member, change)))


def _telling(member: Member, change: MachineChanged) -> Callable[[], Steps]:
    def steps() -> Steps:
        if member.state is _ACTIVE and member.failure is None and not member.left:
            error = yield Call(member, "on_action", (change,))
            if error is not None:
                member.context._life._fail(member, "on_action", error, Failure.ABORT)

    return steps


MultiModeComponent._rt_hook_kinds = dict(Component._rt_hook_kinds) | {"on_mode_changed": 0}
Participant._rt_hook_kinds = dict(Component._rt_hook_kinds) | {"on_action": 0}
