"""A context in a real-time thread of its own: the options that can be requested, and those that are in force.

`realtime_thread.py` waits and runs hooks, `privileges.py` and `process.py` ask the system. As everywhere,
`contexts/schedule.py` decides when ticks are due.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final

from aiorts.clock import to_ns
from aiorts.contexts.periodic import PeriodicContext
from aiorts.contexts.schedule import MAX_RATE, Ceiling, OverrunPolicy, Rate
from aiorts.errors import ConfigurationError
from aiorts.kernel.execution.cell import cell
from aiorts.kernel.execution.context import Timing
from aiorts.kernel.loop.handed_log import HandedLogger
from aiorts.kernel.ports.port import UNSUSPENDED
from aiorts.model.declared import Option
from aiorts.realtime.lock_free import let_go_all, make_all_lock_free, make_lock_free
from aiorts.realtime.privileges import Granted, Wanted
from aiorts.realtime.realtime_thread import RealtimeDriver

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import ComponentSide, KernelSide
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.ports import Port

_SPIN: Final = 50e-6


class RealtimeContext(PeriodicContext):
    """Runs its members `rate` times a second in a thread of its own: absolute deadlines, real-time priority.

    Hooks run without an event loop: plain `def`, or `async def` that never suspends; one that does is closed and its
    component goes to error. Awaited reads and writes at ports work as far as they need not wait, else they raise
    `WouldBlock`. What the machine or the privileges deny is said once, on the logger `aiorts.kernel` and in `granted`,
    and the context runs with what it has. In simulated time nothing is asked for.

    While one runs the process has a switch interval of 100 us, and garbage is collected in the slack between cycles
    only, in this thread, finalizers included.

    Raises:
        ConfigurationError: an option is out of range.
    """

    kind: ClassVar[str] = "realtime"
    exclusive: ClassVar[bool] = True
    suspends: ClassVar[bool] = False
    features: ClassVar[bool] = False

    def __init__(
        self,
        rate: Rate = 1000.0,
        *,
        overrun: OverrunPolicy = "skip",
        max_rate: Ceiling = MAX_RATE,
        name: str = "",
        deadline: Annotated[
            float | None,
            Option(
                "The time after its tick in which a cycle has to be done, else it counts as an overrun; by default a "
                "period. How long a single hook may take, supervision says.",
                unit="s",
                above=0,
            ),
        ] = None,
        timing: Timing = True,
        priority: Annotated[
            int | None,
            Option(
                "The priority by SCHED_FIFO of its thread, 1 is low; in a program None leaves it an ordinary thread.",
                low=1,
                high=99,
            ),
        ] = 50,
        cpus: Annotated[
            Iterable[int] | None, Option("The numbers of the processors that its thread keeps to; by default any.")
        ] = None,
        lock_memory: Annotated[bool, Option("Whether the memory of the process is kept resident.")] = True,
        spin: Annotated[
            bool | float,
            Option(
                "The time by which its thread wakes up earlier, and looks at the clock until the moment has come; true "
                "is 50 us. The interpreter lock is held meanwhile, for a quarter of a period at the most.",
                unit="s",
                low=0,
                high=1e-3,
            ),
        ] = False,
    ) -> None:
        super().__init__(rate, overrun=overrun, max_rate=max_rate, name=name, deadline=deadline, timing=timing)
        self._check_options(RealtimeContext, priority=priority, spin=spin)
        if deadline is not None and self._schedule is not None:
            self._schedule.deadline_ns = to_ns(deadline)
        self._wanted = Wanted(priority, _checked_cpus(cpus), bool(lock_memory))
        self._spin_ns = round((_SPIN if spin is True else spin) * 1e9)
        self.spin = spin
        """The requested time by which the thread wakes up before a deadline."""
        self._granted = Granted()

    @property
    def priority(self) -> int | None:
        """The requested priority; None: no priority."""
        return self._wanted.priority

    @property
    def cpus(self) -> tuple[int, ...] | None:
        """The requested processors; None: any."""
        return None if self._wanted.cpus is None else tuple(sorted(self._wanted.cpus))

    @property
    def lock_memory(self) -> bool:
        """Whether the context requests that the memory of the process stays resident."""
        return self._wanted.lock_memory

    @property
    def granted(self) -> Granted:
        """The privileges in force, and the denied ones with reasons; of the last run once the context has stopped."""
        return self._granted

    def _make_driver(self, kernel: KernelSide) -> RealtimeDriver:
        self._granted = Granted()
        return RealtimeDriver(self, kernel)

    async def add(self, *components: ComponentSide, timeout: float | None = 5.0) -> None:
        try:
            await super().add(*components, timeout=timeout)
        except BaseException:
            for component in components:
                _let_out(component)
            raise

    def _longest_spin_ns(self) -> int:
        """The longest time before a deadline in which the thread polls the clock: at most a quarter of a period."""
        rate = self.rate
        return self._spin_ns if not self._spin_ns or rate is None else min(self._spin_ns, round(0.25e9 / rate))

    def _port_added(self, member: Member, port: Port[Any]) -> None:
        make_all_lock_free(port)
        super()._port_added(member, port)

    def _new_member(self, component: ComponentSide) -> Member:
        # On the loop, before the thread has anything to do with the component.
        kernel, log = self.runner.kernel, component.log
        cell(component).realtime, cell(component).prepare = True, make_lock_free
        for port in component.ports.values():
            make_all_lock_free(port)
        if not isinstance(log.logger, HandedLogger):
            log.logger = HandedLogger(log.logger, kernel.call_on_loop)
        return super()._new_member(component)

    def _set_ports_open(self, member: Member) -> None:
        super()._set_ports_open(member)
        if member.left:
            self.runner.kernel.call_on_loop(partial(_let_out, member.component))


def _let_out(component: ComponentSide) -> None:
    """Return a component to the loop if it is in no context, since it has left its real-time thread."""
    if component.contexts or cell(component).abandoned is not None:
        return  # an abandoned hook may still be inside
    host, log = cell(component), cell(component).log
    host.realtime, host.prepare, host.thread_id, host.turns.left = False, None, None, UNSUSPENDED
    if log is not None and isinstance(log.logger, HandedLogger):
        log.logger = log.logger.real
    for port in component.ports.values():
        let_go_all(port)


def _checked_cpus(cpus: Iterable[int] | None) -> frozenset[int] | None:
    if cpus is None:
        return None
    wanted = frozenset(cpus) if isinstance(cpus, Iterable) else frozenset[int]()
    if not wanted or any(not isinstance(cpu, int) or isinstance(cpu, bool) or cpu < 0 for cpu in wanted):
        raise ConfigurationError(f"cpus = {cpus!r}: expected numbers of processors such as [1], or None")
    return wanted
