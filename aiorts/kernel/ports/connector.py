"""A connector: one out-port, one in-port, the options both agreed on, and the transport that carries its samples.

Users hold a `Connector`. A `Transport` (`transport.py`) carries its samples. The transport is replaced, with all that
it holds, when a real-time thread or a listener comes or goes; the connector stays.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Never

from aiorts.errors import ClosedError
from aiorts.model.buffer import FullPolicy
from aiorts.model.profile import ConnectorProfile, ConnectorStatistics

if TYPE_CHECKING:
    from aiorts.kernel.ports.in_port import InPort
    from aiorts.kernel.ports.out_port import OutPort
    from aiorts.kernel.ports.port import Port
    from aiorts.kernel.ports.transport import Transport
    from aiorts.model.timing import PublisherTiming


class Connector:
    """One live connection, made by `Kernel.connect` and ended by `Kernel.disconnect`.

    Attributes:
        profile: the options in force, frozen.
        out: the out-port.
        in_: the in-port.
        parked: whether the connector is parked: for a time no sample is written to it; unread samples stay.
    """

    __slots__ = ("_transport", "in_", "out", "parked", "profile")

    _transport: Transport

    def __init__(self, profile: ConnectorProfile, out: OutPort[Any], in_: InPort[Any]) -> None:
        self.profile = profile
        self.out = out
        self.in_ = in_
        self.parked = False

    @property
    def name(self) -> str:
        """The connector's name, unique in its kernel."""
        return self.profile.name

    @property
    def closed(self) -> bool:
        """Whether the connector was disconnected."""
        return self._transport.closed

    @property
    def statistics(self) -> ConnectorStatistics:
        """The counts of written, delivered, buffered and dropped samples at this moment.

        Raises:
            ThreadError: read outside the loop's thread, while neither end belongs to a ThreadContext.
        """
        found = self._transport.statistics()
        kernel = None if self.profile.max_gap is None or self.out._host is None else self.out._host.kernel
        return found if kernel is None else kernel.connections.gaps.added(found, self)

    @property
    def timing(self) -> PublisherTiming | None:
        """When and how long this connector sent, over its last `measure` sends; None when `measure` was not given.

        `measure` is an option of `Kernel.connect`; OpenRTM's keys `measurement.*` are aliases.
        """
        transport = self._transport
        with transport.guard():
            return None if transport.times is None else transport.times.timing

    def close(self) -> None:
        """End this connector as `Kernel.disconnect` does, on the kernel's loop. Idempotent."""
        host = self.out._host
        if host is not None and host.kernel is not None and not self.closed:
            host.check_loop_thread(f"{self.name}: its end was")
            host.kernel.connections.end(self)

    def change(
        self,
        *,
        push_rate: float | None = None,
        length: int | None = None,
        full: Literal["overwrite", "reject", "block"] | FullPolicy | None = None,
        **others: Never,
    ) -> None:
        """Change options while connected; if one option is refused, none is changed. No sample is lost.

        Unread samples stay, even if they are more than the new length: a write then meets a full buffer, and by `full`
        overwrites one, is rejected, or waits until fewer than `length` are unread. Writers that wait for room go on as
        far as a larger `length` has room. If `full` is no longer "block", all of them go on, in order, also beyond the
        length. A `push_rate` begins a period: the n-th after it ends n / push_rate seconds after the change.

        Args:
            push_rate: Hz, of a periodic connector.
            length: samples that the reader's buffer holds.
            full: "overwrite", "reject", "block".

        Raises:
            WiringError: names the option that is wrong or cannot be changed, or says that none was given.
            StateError: a real-time thread uses the connector.
            ClosedError: the connector was disconnected.
            ThreadError: called in another thread than the loop's.
        """
        host = self.out._host
        if host is None or host.kernel is None or self.closed:
            raise ClosedError(f"{self.name}: change: this connector was disconnected; connect anew with these options")
        host.check_loop_thread(f"{self.name}: a change was")
        given = {"push_rate": push_rate, "length": length, "full": full, **others}
        host.kernel.connections.change(self, {key: value for key, value in given.items() if value is not None})

    def __repr__(self) -> str:
        p = self.profile
        mark = " closed" if self.closed else ""
        options = f"{p.subscription}/{p.push} length={p.length} full={p.full}"
        return f"<Connector {self.out.path} -> {self.in_.path} {options}{mark}>"


def transport_of(connector: Connector) -> Transport:
    """The connector's present transport; call this each time, since the transport may be replaced."""
    return connector._transport


def unread_of(connector: Connector) -> int:
    """Samples of this connector that the reader can read now."""
    transport = connector._transport
    transport.settle()
    return len(transport.queue)


def unread_at(port: Port[Any]) -> int:
    """Samples that can be read now, of all connectors of an in-port or out-port."""
    return sum(unread_of(connector) for connector in port.connectors)
