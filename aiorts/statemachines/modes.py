"""Components with modes, and components that take part in another's state machine: each has one further hook.

Both are of the RTC specification (multi-mode package; FSM participant). Their hooks run as all others: by the context,
between two cycles, under its deadline.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from aiorts.errors import ComponentError, DeclarationError, StateError
from aiorts.kernel.component import Component, Hook
from aiorts.kernel.declarations import Kind, declarations
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.cycle import Action, Call
from aiorts.kernel.execution.hooks import further_kinds
from aiorts.kernel.loop.bus import Event
from aiorts.kernel.loop.origins import located
from aiorts.late import dataclass
from aiorts.model.lifecycle import Failure, LifecycleState
from aiorts.model.names import check_name
from aiorts.statemachines.charting import hint

if TYPE_CHECKING:
    from aiorts.kernel.execution.cycle import Done, Steps
    from aiorts.kernel.execution.member import Member
    from aiorts.statemachines.machine_events import MachineChanged
    from aiorts.statemachines.state_machine import StateMachine

_ERROR = LifecycleState.ERROR
_ACTIVE = LifecycleState.ACTIVE


@dataclass(frozen=True, slots=True)
class ModeChanged(Event):
    """Published after `on_mode_changed`: a component has another mode in this context ("": it is in no context)."""

    component: str
    context: str
    old: str
    new: str


class _Modes:
    """The modes of one component, and the requests to change them."""

    __slots__ = ("by_context", "newest", "pending")

    def __init__(self, mode: str) -> None:
        self.newest = mode
        """The mode requested last that took effect in some context."""
        self.by_context: dict[str, str] = {}
        """The mode in each context, while contexts differ in mode."""
        self.pending: list[list[str]] = []
        """Requests that have not taken effect yet: one list object for each."""

    def of(self, context: str) -> str:
        """The mode in a context."""
        return self.by_context.get(context, self.newest)


class ModesKind(Kind):
    """Describes components with modes for introspection."""

    def reports(self, component: MultiModeComponent) -> Mapping[str, Any]:
        """The modes there are, and the present one."""
        from aiorts.observe import ModeReport

        modes = tuple(component.modes)
        return {"modes": ModeReport(modes, component.mode, component.modes_by_context, component.pending_mode)}


class MultiModeComponent(Component, kind=ModesKind()):
    """A component that works in one of several modes, named in `modes`; the first is the default.

        class Arm(MultiModeComponent):
            modes = ("manual", "automatic")

            async def on_mode_changed(self) -> None:
                self.log.info("now %s", self.mode)

    A change takes place between two cycles, in each context of its own, and never waits for a tick.

    Raises:
        DeclarationError: the class names no modes, or one of them twice.
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
        declarations(cls).hook_kinds |= further_kinds(cls, MultiModeComponent, {"on_mode_changed": ("self",)})

    def __init__(self, name: str = "") -> None:
        if not self.modes:
            raise DeclarationError(f'{type(self).__qualname__}: has no modes; write modes = ("manual", "automatic")')
        super().__init__(name)
        cell(self).own = {**cell(self).own, _Modes: _Modes(self.modes[0])}

    @property
    def default_mode(self) -> str:
        """The mode in which the component begins."""
        return self.modes[0]

    @property
    def mode(self) -> str:
        """The mode in the context whose hook runs; else the one requested last that took effect in some context."""
        running, modes = cell(self).running, _modes_of(self)
        return modes.newest if running is None else modes.of(running.context.name)

    @property
    def pending_mode(self) -> str | None:
        """The mode requested last that has not taken effect in every context yet; None where there is none."""
        pending = _modes_of(self).pending
        return pending[-1][0] if pending else None

    @property
    def modes_by_context(self) -> Mapping[str, str]:
        """The mode in each context, by the context's name."""
        modes = _modes_of(self)
        return MappingProxyType({each.name: modes.of(each.name) for each in self.contexts})

    async def set_mode(self, mode: str, timeout: float | None = 5.0) -> None:
        """Change the mode and run `on_mode_changed` in every context; in its own hooks the request is queued.

        Nothing runs when it has the mode already, or is in no context.

        Raises:
            StateError: there is no such mode, or the component is in error.
            ComponentError: the hook raised, and the
                component is in error.
            TransitionTimeout: a context did not carry it out within `timeout` seconds.
        """
        if mode not in self.modes:
            raise StateError(f"{self.name}: no mode {mode!r}{hint(mode, self.modes)}")
        kernel = cell(self).kernel
        if kernel is not None:
            kernel.check_thread(f"{self.name}.set_mode")
        members, modes = tuple(cell(self).members), _modes_of(self)
        if any(member.state is _ERROR for member in members):
            raise StateError(f"{self.name}: cannot change its mode in error; reset it first")
        if not members:
            old = modes.newest
            _enter(self, "", mode)
            if kernel is not None and old != mode:
                kernel.bus.publish(ModeChanged(self.name, "", old, mode))
            return
        request = [mode]
        modes.pending.append(request)
        try:
            for member in members:
                await member.context.runner.ask(
                    [(f"change mode of {self.name}", partial(_change, self, member, mode))], timeout
                )
        except BaseException:
            # This request was withdrawn; others for the same mode may wait.
            modes.pending = [one for one in modes.pending if one is not request]
            raise

    def on_mode_changed(self) -> Hook:
        """Called when the mode has changed to `mode`. An exception moves the component to error; the new mode stays."""
        return None


def _modes_of(component: MultiModeComponent) -> _Modes:
    found: _Modes = cell(component).own[_Modes]
    return found


def _enter(component: MultiModeComponent, context: str, mode: str) -> None:
    modes = _modes_of(component)
    old = modes.of(context)
    modes.newest = mode
    if context:
        # Contexts in which the mode has not changed yet are still in the old mode.
        for member in cell(component).members:
            modes.by_context.setdefault(member.context.name, old)
        modes.by_context[context] = mode
    _settle(component, mode)


def _settle(component: MultiModeComponent, mode: str) -> None:
    """Clear the pending mode when every context has it."""
    if all(each == mode for each in component.modes_by_context.values()):
        modes = _modes_of(component)
        wanted = [request for (request,) in modes.pending]
        if mode in wanted:  # earlier requests have been carried out or withdrawn
            del modes.pending[: wanted.index(mode) + 1]
        modes.by_context.clear()


def _change(component: MultiModeComponent, member: Member, mode: str, done: Done) -> Steps:
    context = member.context
    old = _modes_of(component).of(context.name)
    failure: BaseException | None = None
    if old != mode and not member.left:
        _enter(component, context.name, mode)
        error = yield Call(member, "on_mode_changed")
        if error is not None:
            context.runner.life.failed(member, "on_mode_changed", error, Failure.ABORT)
            failure = ComponentError(f"{component.name}: on_mode_changed raised {located(error)}")
            failure.__cause__ = error
        context.runner.publish(ModeChanged(component.name, context.name, old, mode))
    else:
        _settle(component, mode)
    done(failure)


class ParticipantKind(Kind):
    """Describes participants to the kernel."""

    def removed(self, component: Participant) -> None:
        for machine in notifiers_of(component):
            machine.remove_participant(component)

    def heritage(self, component: Participant) -> Callable[[Component], None]:
        machines = notifiers_of(component)

        def hand_over(new: Component) -> None:
            if isinstance(new, Participant):
                for machine in machines:
                    machine.add_participant(new)

        return hand_over


class Participant(Component, kind=ParticipantKind()):
    """A component that is notified of each change of another's state machine: `door.machine.add_participant(arm)`.

    `on_action` runs in the participant's own context, between two cycles, while it is active.
    """

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        declarations(cls).hook_kinds |= further_kinds(cls, Participant, {"on_action": ("self", "change")})

    def on_action(self, change: MachineChanged) -> Hook:
        """Called when a machine that this component takes part in has changed its configuration."""
        return None


def notifiers_of(component: Participant) -> tuple[StateMachine, ...]:
    """The machines that notify a participant of their changes."""
    machines: tuple[StateMachine, ...] = cell(component).own.get(Participant, ())
    return machines


def set_notifiers(component: Participant, machines: tuple[StateMachine, ...]) -> None:
    """Set the machines that notify a participant of their changes."""
    cell(component).own = {**cell(component).own, Participant: machines}


def notify(component: Participant, change: MachineChanged) -> None:
    """Run `on_action` in each context of the component. Called on the kernel's loop."""
    for member in cell(component).members:
        member.context.runner.submit(Action(_telling(member, change)))


def _telling(member: Member, change: MachineChanged) -> Callable[[], Steps]:
    def steps() -> Steps:
        if member.state is _ACTIVE and member.failure is None and not member.left:
            error = yield Call(member, "on_action", (change,))
            if error is not None:
                member.context.runner.life.failed(member, "on_action", error, Failure.ABORT)

    return steps


declarations(MultiModeComponent).hook_kinds = dict(declarations(Component).hook_kinds) | {"on_mode_changed": 0}
declarations(Participant).hook_kinds = dict(declarations(Component).hook_kinds) | {"on_action": 0}
