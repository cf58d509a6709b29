"""Reads several in-ports and gives out the samples that belong together."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Final, Generic, TypeVar, cast, overload

from anyio import WouldBlock

from aiorts.clock import to_ns
from aiorts.errors import ConfigurationError
from aiorts.kernel.ports import InPort
from aiorts.kernel.ports.in_port import receiver_of
from aiorts.kernel.ports.port import host_of
from aiorts.kernel.ports.waiting import wait_until
from aiorts.model.values import shown
from aiorts.sync.matching import POLICIES, Matching, SynchronizerStatistics

A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
D = TypeVar("D")
M = TypeVar("M", bound="tuple[Any, ...]")

_NEAREST: Final = 0.01
"""Seconds of tolerance where none are given."""


class Synchronizer(Generic[M]):
    """Gives out the samples of several in-ports of a component that belong together, by their time stamps `tm` alone.

    It is the only reader of the ports. Make it in the component's `__init__`. The stamps of each port go up. With
    "nearest" and "latest" the first port leads: each of its samples gives at most one match. The same samples give
    the same matches, in whatever order those of different ports arrive, as long as no port overflows.

    Args:
        ports: two in-ports or more, whose types have a time stamp `tm`.
        policy: "exact" matches samples of one and the same stamp; "nearest" those nearest to a sample of the first
            port, and to no other of its samples, each used once; "latest" the last ones that are not after it, used as
            often as needed.
        tolerance: seconds between the stamp of the first port's sample and the others. None is 0.01 with "nearest" and
            any with "latest". "exact" takes none.
        length: samples held of each port until those of the others are there; then the oldest is dropped.

    Raises:
        ConfigurationError: a port or an option is wrong.
    """

    @overload
    def __init__(
        self: Synchronizer[tuple[A, B]],
        *ports: *tuple[InPort[A], InPort[B]],
        tolerance: float | None = None,
        policy: str = "nearest",
        length: int = 8,
    ) -> None: ...
    @overload
    def __init__(
        self: Synchronizer[tuple[A, B, C]],
        *ports: *tuple[InPort[A], InPort[B], InPort[C]],
        tolerance: float | None = None,
        policy: str = "nearest",
        length: int = 8,
    ) -> None: ...
    @overload
    def __init__(
        self: Synchronizer[tuple[A, B, C, D]],
        *ports: *tuple[InPort[A], InPort[B], InPort[C], InPort[D]],
        tolerance: float | None = None,
        policy: str = "nearest",
        length: int = 8,
    ) -> None: ...
    @overload
    def __init__(
        self: Synchronizer[tuple[Any, ...]],
        *ports: InPort[Any],
        tolerance: float | None = None,
        policy: str = "nearest",
        length: int = 8,
    ) -> None: ...
    def __init__(
        self, *ports: InPort[Any], tolerance: float | None = None, policy: str = "nearest", length: int = 8
    ) -> None:
        where = _check_ports(ports)
        if policy not in POLICIES:
            raise ConfigurationError(f"{where}: policy = {shown(policy)}: expected {', '.join(POLICIES)}")
        if isinstance(length, bool) or not isinstance(length, int) or length < 1:
            raise ConfigurationError(f"{where}: length = {shown(length)}: expected a whole number, 1 or more")
        self.ports = ports
        self.policy = policy
        self.tolerance = _checked_tolerance(tolerance, policy, where)
        self.length = length
        within = None if self.tolerance is None else to_ns(self.tolerance)
        self._matching = Matching(len(ports), policy, within, length)

    def match_nowait(self) -> M:
        """The next match: one sample of each port, in the order of the ports.

        One sample may complete several matches: in a hook take all of them, as `drain` does.

        Raises:
            WouldBlock: there is none.
            ClosedError: one of the ports was removed.
        """
        found = self._look()
        if found is None:
            raise WouldBlock(f"{self._where}: no match")
        return found

    def drain(self) -> list[M]:
        """Every match that there is now, oldest first."""
        matches = []
        while (found := self._look()) is not None:
            matches.append(found)
        return matches

    async def match(self, timeout: float | None = None) -> M:
        """The next match, waiting for it; a cancelled wait loses nothing.

        Args:
            timeout: seconds of the kernel's clock; 0 looks once, None waits forever.

        Raises:
            ReadTimeout: there was no match in time.
            BusyError: another task waits on one of the ports.
            ClosedError: one of the ports was removed.
            ConfigurationError: `timeout` is no number of seconds.
        """
        return await wait_until(self.ports, self._look, self._where, "no match", timeout)

    @property
    def statistics(self) -> Mapping[str, SynchronizerStatistics]:
        """The counts of samples, by the name of the port."""
        cleared = self._reopened()
        host = host_of(self.ports[0])
        kernel = None if host is None else host.kernel
        now_ns = 0 if kernel is None else kernel.clock.monotonic_ns()
        return {
            port.name: replace(self._matching.statistics(number, cleared=cleared), at_ns=now_ns)
            for number, port in enumerate(self.ports)
        }

    def __repr__(self) -> str:
        return f"<Synchronizer {self._where} policy={self.policy} tolerance={self.tolerance} length={self.length}>"

    @property
    def _where(self) -> str:
        """Its name in messages: a component gets its full name when it is added to a kernel."""
        return _named(self.ports)

    def _look(self) -> M | None:
        """The next match, for which samples are read from the ports; None where there is none."""
        matching = self._matching
        if self._reopened():
            matching.clear()
        # The port that is behind is read first, so that none overflows while samples lie unread at another.
        behind = set(range(len(self.ports)))
        while (found := matching.match()) is None:
            if not behind:
                return None
            number = min(behind, key=self._newest)
            try:
                sample = self.ports[number].read_nowait()
            except WouldBlock:
                behind.discard(number)
                continue
            tm = sample.tm
            matching.offer(number, tm if isinstance(tm, int) else tm.ns, sample)
        return cast("M", found)

    def _newest(self, number: int) -> float:
        newest = self._matching.lanes[number].newest
        return -math.inf if newest is None else newest

    def _reopened(self) -> bool:
        """Whether the component was not active since a sample was taken: its ports have forgotten what was read."""
        return any(
            lane.newest is not None and (not receiver.open or receiver.last_read is None)
            for lane, receiver in zip(self._matching.lanes, map(receiver_of, self.ports), strict=True)
        )


def _named(ports: Iterable[InPort[Any]]) -> str:
    return f"Synchronizer({', '.join(port.path for port in ports)})"


def _check_ports(ports: tuple[object, ...]) -> str:
    """Raise ConfigurationError unless these can be synchronised; return their name in messages."""
    from aiorts.types import has_tm

    checked = []
    for port in ports:
        if not isinstance(port, InPort):
            raise ConfigurationError(
                f"Synchronizer: {shown(port)}: expected in-ports of a component, such as self.image"
            )
        if "." not in port.path:
            raise ConfigurationError(
                f"Synchronizer: {port!r}: expected a port of a component; make the Synchronizer in its __init__, after "
                "super().__init__(...), of self.image, self.pose"
            )
        checked.append(port)
    where = _named(checked)
    if len(checked) < 2:
        raise ConfigurationError(f"{where}: expected two in-ports or more")
    if len(set(checked)) < len(checked):
        raise ConfigurationError(f"{where}: expected each in-port once")
    if len({port.path.rpartition(".")[0] for port in checked}) > 1:
        raise ConfigurationError(f"{where}: expected in-ports of one component")
    for port in checked:
        if not has_tm(port.type):
            raise ConfigurationError(
                f"{where}: {port.path}: {port.type.__name__} has no time stamp; use a record with a field tm, such as "
                "aiorts.types.TimedDouble"
            )
    return where


def _checked_tolerance(tolerance: object, policy: str, where: str) -> float | None:
    if tolerance is None:
        return _NEAREST if policy == "nearest" else None
    number = not isinstance(tolerance, bool) and isinstance(tolerance, int | float)
    if not number or not 0 <= cast("float", tolerance) < math.inf:
        raise ConfigurationError(f"{where}: tolerance = {shown(tolerance)}: expected seconds, 0 or more, or None")
    if policy == "exact":
        raise ConfigurationError(
            f'{where}: tolerance = {shown(tolerance)}: policy "exact" takes none; leave it out, or use "nearest"'
        )
    return cast("float", tolerance)
