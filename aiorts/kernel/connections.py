"""The connectors of one kernel, by name: all of a call come into being or none, and each ends once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Unpack

from aiorts.errors import StateError, WiringError
from aiorts.kernel.execution.apart import check_connection
from aiorts.kernel.loop.bus import Connected, ConnectorChanged, Disconnected
from aiorts.kernel.loop.guarded import KernelLog, guarded
from aiorts.kernel.ports import InPort, OutPort, Port, PortDeclaration, wiring
from aiorts.kernel.ports.connector import Connector, transport_of, unread_of
from aiorts.kernel.ports.features import offer
from aiorts.kernel.ports.losses import Early, Losses, Unconverted
from aiorts.kernel.ports.tap import Injector, make_injector, make_tap, resize
from aiorts.kernel.quality import FEATURES, Gaps
from aiorts.kernel.service import notify, report_fault
from aiorts.model.naming import Numbering
from aiorts.model.options import (
    AGAIN,
    PortLimits,
    changed_profile,
    connector_profile,
    idle,
    loses_unasked,
    says_what_is_lost,
    transport_notice,
    with_openrtm,
    without_effect,
)
from aiorts.model.ordering import arrange
from aiorts.model.profile import ConnectorProfile

if TYPE_CHECKING:
    from aiorts.kernel.connection import Connection
    from aiorts.kernel.execution.cell import KernelSide
    from aiorts.kernel.ports.far import FarPorts
    from aiorts.kernel.ports.port import Connecting
    from aiorts.kernel.service import KernelService
    from aiorts.model.connect_options import ConnectOptions

_LOG = KernelLog()
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})
offer(*FEATURES)


class Connections:
    """The connectors of a kernel, and the ways to make, change and end them."""

    def __init__(self, kernel: KernelSide) -> None:
        self._kernel = kernel
        self.connectors: dict[str, Connector] = {}
        self.service_connectors: dict[str, Any] = {}
        """The connectors of service ports, by name."""
        self.losses, self.early = Losses(kernel), Early(kernel)
        self.gaps = Gaps(kernel)
        self.unconverted = Unconverted(kernel)
        self.far: FarPorts | None = None
        """The maker of stand-ins for ports of other kernels; None: there are no other kernels."""
        self._numbering = Numbering(self._taken)
        self._idle: set[str] = set()
        """Warnings of options that choose nothing, each given once."""
        self._reported: set[str] = set()
        """Options without effect that have been warned of."""

    def make(self, ports: Sequence[Any], options: Mapping[str, Any]) -> list[Any]:
        """Connect every out-port with every in-port, or service ports with one another.

        Raises:
            InvalidNameError: a text is no path.
            WiringError: says which ports or options do not go together; nothing was connected.
        """
        options = with_openrtm(options)
        if self.far is not None and len(ports) > 2 and (pairs := self._pairs(ports)):
            return self._make_each(pairs, options)
        given = options  # by the user: what is usual for a link says what is lost, too
        ports, options = self._resolve(ports, options)
        if (connecting := _connecting(ports)) is not None:
            return self._make_others(connecting.plan(self._kernel, ports, options), options)
        plans = self._plan(ports, options)
        if options:
            self._report_idle(options, plans[0])
        chosen = says_what_is_lost(given, plans[0][-1])
        reports_losses = not chosen and all(loses_unasked(profile) for *_, profile in plans)
        made = []
        for out, in_, profile in plans:
            name = self._free_name(profile.name, f"{out.path}-{in_.path}", len(plans))
            connector = wiring.wire(self._kernel, out, in_, replace(profile, name=name))
            self.connectors[name] = connector
            if reports_losses and in_.length is None:
                self.losses.listen(connector)
            made.append(connector)
        if options:
            self._report_once([key for key in without_effect(options) if key not in self._reported], made[0])
        for connector in made:
            self._notify_made(connector)
        return made

    def _plan(
        self, ports: Sequence[Any], options: Mapping[str, Any]
    ) -> list[tuple[OutPort[Any], InPort[Any], ConnectorProfile]]:
        plans = wiring.plan(self._kernel, ports, options)
        for out, in_, profile in plans:
            if not profile.length:
                check_connection(out, in_)
        return plans

    def fault(self, one: PortDeclaration, other: PortDeclaration) -> str:
        """Why `make` would not connect these ports of this kernel, without options; "" where it would."""
        ports, connecting = (one, other), _connecting((one, other))
        try:
            if connecting is None:
                self._plan(ports, _NOTHING)
            else:
                connecting.plan(self._kernel, ports, _NOTHING)
        except WiringError as error:
            return str(error)
        return ""

    def _pairs(self, ports: Sequence[Any]) -> list[tuple[Any, Any]]:
        """Each out-port with each in-port, where one of them runs in another process."""
        find = self._kernel.registry.port
        found = [find(one) if isinstance(one, str) and "/" not in one else one for one in ports]
        if not any(isinstance(one, Port) and one.elsewhere is not None for one in found):
            return []
        outs = [one for one in found if isinstance(one, OutPort)]
        ins = [one for one in found if isinstance(one, InPort)]
        return [(out, in_) for out in outs for in_ in ins] if len(outs) + len(ins) == len(found) else []

    def _make_each(self, pairs: Sequence[tuple[Any, Any]], options: Mapping[str, Any]) -> list[Any]:
        """Connect these ports one pair after the other; all or none."""
        made: list[Any] = []
        name = str(options.get("name") or "")
        try:
            for pair in pairs:
                own = {"name": self._numbering.lowest(f"{name}-", 2)} if name and self._taken(name) else {}
                made += self.make(pair, {**options, **own})
        except BaseException:
            self.end_each(made[::-1])
            raise
        return made

    def _resolve(self, ports: Sequence[Any], options: Mapping[str, Any]) -> tuple[list[Any], Mapping[str, Any]]:
        """The ports of paths, and the options with what is usual where one is in another kernel."""
        far = self.far
        is_far = [far is not None and isinstance(one, str) and far.is_far(one) for one in ports]
        found = [
            self._kernel.registry.port(one) if isinstance(one, str) and not beyond else one
            for one, beyond in zip(ports, is_far, strict=True)
        ]
        if far is not None and (any(is_far) or any(getattr(one, "elsewhere", None) for one in found)):
            ends, options = far.resolve(found, options)
            for port in found:
                if isinstance(port, Port) and port.elsewhere is not None:
                    # Its kernel knows no limit: there, taps are connectors like others.
                    wiring.check_limit(port, sum(end.direction != port.direction for end in ends), PortLimits())
            return ends, options
        if options.get("on_link_lost") is not None:
            raise WiringError("on_link_lost: both ports are in this kernel; there is no link that could be lost")
        return found, options

    def change(self, connector: Connector, options: Mapping[str, Any]) -> None:
        """See `Connector.change`."""
        self.check_mine(connector)
        before = connector.profile
        where = f"{connector.out.path} -> {connector.in_.path}"
        profile = changed_profile(where, before, options)
        if before.far_end == "writer" and profile.push_rate != before.push_rate:
            raise StateError(
                f"{where}: push_rate: its period is in the process of the writer; disconnect and connect anew"
            )
        transport_of(connector).change(profile)
        if says_what_is_lost(options, profile):
            self.losses.stop(connector)
        if profile != before:
            self._report_idle(options, (connector.out, connector.in_, profile))
            self._kernel.bus.publish(ConnectorChanged(profile, before))

    def replace_options(self, connector: Connector, options: Mapping[str, Any]) -> None:
        """Replace all options of a connector by these; waiting and unread samples go over, in order.

        Raises:
            WiringError: as `make`; nothing was changed.
            StateError: a real-time thread is at it.
        """
        self.check_mine(connector)
        if connector.in_.is_far or connector.out.is_far:
            raise StateError(f"{connector.name}: its other end is in another kernel; disconnect and connect anew")
        before, options = connector.profile, with_openrtm(options)
        profile = wiring.renewed_profile(connector, options)
        if profile == before:
            return
        if not transport_of(connector).listenable:
            raise StateError(f"{connector.name}: a real-time thread is at it; disconnect and connect anew")
        if not profile.length:
            check_connection(connector.out, connector.in_)
        wiring.renew(self._kernel, connector, profile)
        self.losses.stop(connector)
        if connector.in_.length is None and not says_what_is_lost(options, profile) and loses_unasked(profile):
            self.losses.listen(connector)
        self.unconverted.end(connector)
        self.gaps.end(connector)
        self.gaps.add(connector)
        self._report_idle(options, (connector.out, connector.in_, profile))
        self._kernel.bus.publish(ConnectorChanged(profile, before))

    def park(self, connector: Connector) -> None:
        """Take a connector out of force with all that is unread in it, until `unpark` or `end`."""
        self.check_mine(connector)
        wiring.park(connector)
        self.losses.end(connector)
        self.gaps.end(connector)
        self._forget(connector)

    def unpark(self, connector: Connector) -> None:
        """Put a parked connector in force again, under its name, which is free."""
        wiring.unpark(connector)
        self.connectors[connector.name] = connector
        self._notify_made(connector)

    def arrange(self, names: Sequence[str], at_ports: Mapping[Port[Any], Sequence[Connector]]) -> None:
        """Put the connectors in this order, and those of each of these ports in its own; others come behind them."""
        arrange(self.connectors, names)
        arrange(self.service_connectors, names)
        for port, connectors in at_ports.items():
            wiring.arrange(port, connectors)

    def measure(self, connector: Connector, count: int) -> None:
        """Time the last `count` sends and reads of a connector from now on, or none with 0: its option `measure`.

        Raises:
            StateError: a real-time thread is at it.
        """
        self.check_mine(connector)
        if not transport_of(connector).listenable:
            raise StateError(f"{connector.name}: a real-time thread is at it; connect it with measure = 1000 instead")
        before = connector.profile
        if before.measure != count:
            wiring.measure(connector, count)
            self._kernel.bus.publish(ConnectorChanged(connector.profile, before))

    def tap(
        self,
        service: KernelService,
        out: OutPort[Any],
        take: Callable[[InPort[Any]], object],
        **options: Unpack[ConnectOptions],
    ) -> Connector:
        """Let a service take what an out-port writes, until the returned connector is closed.

        `take` is called with an in-port that has something to read: in the write itself, or soon on the loop where a
        thread writes; also while it reads, where that lets a waiting writer in. What it leaves is there at the next
        call. The system stays what it is: no profile, no supervision and no end of a run sees the connector, whose
        ledger counts like any other's. Of an out-port in another process it counts what has come from there.

        Args:
            options: those of a connector; a write waits without a time-out unless they say one. With `keep_last` there
                is the sample that the port wrote last before, too; `take` is not called for it.
        """
        given = {"timeout": None, **options}
        profile, _ = connector_profile(out.path, given, f"{out.path}-{service.name}", (out.path,))

        def contained(port: InPort[Any]) -> None:
            try:
                take(port)
            except Exception as error:  # noqa: BLE001 - the border round a plugin's service
                report_fault(service, f"{out.path}: its tap", error)

        return self._linked(make_tap(self._kernel, service.name, out, profile, contained))

    def inject(self, service: KernelService, in_: InPort[Any], options: Mapping[str, Any]) -> Connector:
        """Let a service write to an in-port, until the returned connector is closed; it writes to `connector.out`.

        The system stays what it is, as with `tap`.

        Args:
            options: `length`, `full` and `timeout`, as `connect` has them.

        Raises:
            WiringError: an option is wrong, or goes with no real-time thread, and one is at the in-port.
        """
        profile, _ = connector_profile(in_.path, options, f"{service.name}-{in_.path}", (in_.path,))
        wiring.check_features(Injector(in_.type), in_, profile)
        return self._linked(make_injector(self._kernel, service.name, in_, profile))

    def _linked(self, connector: Connector) -> Connector:
        """A service's own connector, with the link that it has where a port runs in another process."""
        if self.far is not None and connector.profile.far_end:
            self.far.connector_made(connector)
        return connector

    def resize_tap(self, connector: Connector, length: int) -> None:
        """Let a tap leave so many samples unread from now on; those that are there stay."""
        resize(connector, length)

    def unread(self, connector: Connector) -> int:
        """Samples of a connector, such as a tap, that can be read now."""
        return unread_of(connector)

    def _notify_made(self, connector: Connector) -> None:
        self._kernel.bus.publish(Connected(connector.profile))
        self.gaps.add(connector)
        notify(self._kernel.services, "connector_made", connector)

    def _report_idle(
        self, options: Mapping[str, Any], plan: tuple[OutPort[Any], InPort[Any], ConnectorProfile]
    ) -> None:
        """Warn of options that choose nothing, once for each."""
        out, in_, profile = plan
        for _, text in idle(options, profile):
            if text not in self._idle:
                self._idle.add(text)
                _LOG.warning("W-OPTION: %s: %s", profile.name or f"{out.path}-{in_.path}", text)

    def _report_once(self, keys: Sequence[str], connector: Connector) -> None:
        if keys:
            self._reported.update(keys)
            _LOG.warning("W-TRANSPORT: %s: %s", connector.name, transport_notice(keys))

    def _make_others(self, plans: Sequence[tuple[str, Any]], options: Mapping[str, Any]) -> list[Any]:
        """Connectors that are none of data ports."""
        made = []
        for path, plan in plans:
            name = self._free_name(str(options.get("name") or ""), path, len(plans))
            connector = self.service_connectors[name] = plan.make(name)
            made.append(connector)
        for connector in made:
            self._kernel.bus.publish(Connected(connector.profile))
        return made

    def _taken(self, name: str) -> bool:
        return name in self.connectors or name in self.service_connectors

    def _those(self, connector: Any) -> dict[str, Any]:
        return self.connectors if isinstance(connector, Connector) else self.service_connectors

    def renew(self, profile: Any, *, reports_losses: bool) -> Any:
        """Connect the first two ports of a profile, the writer's first, as before; `tells`: losses are reported.

        Raises:
            WiringError: there is no such port any more, or they do not go together any more.
        """
        if not isinstance(profile, ConnectorProfile):
            return self._renew_other(profile)
        given = {**AGAIN, "convert": profile.convert, "on_link_lost": profile.on_link_lost}
        ends, options = self._resolve(profile.ports[:2], given)
        ((writer, reader, planned),) = wiring.plan(self._kernel, ends, options)
        wiring.check_features(writer, reader, profile)
        if not profile.length:
            check_connection(writer, reader)
        name = profile.name if not self._taken(profile.name) else self._free_name("", profile.name, 1)
        connector = wiring.wire(self._kernel, writer, reader, replace(profile, name=name, convert=planned.convert))
        self.connectors[name] = connector
        if reports_losses:
            self.losses.listen(connector)
        self._notify_made(connector)
        return connector

    def _renew_other(self, profile: Any) -> Any:
        port: Any = self._kernel.registry.find(profile.ports[0])
        plan = port.connecting.renewed(self._kernel, profile)
        name = profile.name if not self._taken(profile.name) else self._free_name("", profile.name, 1)
        connector = self.service_connectors[name] = plan.make(name)
        self._kernel.bus.publish(Connected(connector.profile))
        return connector

    def _free_name(self, given: str, path: str, count: int) -> str:
        base = given or path
        if given and count == 1 and self._taken(given):
            raise WiringError(f"{path}: there is a connector named {given!r}; choose another")
        return self._numbering.lowest(f"{base}-", 2) if self._taken(base) else base

    def check_mine(self, connector: Any) -> None:
        """Raise WiringError unless it is one of this kernel's, closed or not."""
        if not hasattr(connector, "closed"):
            raise WiringError(
                f"{connector!r:.100}: expected a connector or a Connection, as connect returns them; "
                f"{self._kernel.name}.connectors has the connectors by name"
            )
        if not connector.closed and self._those(connector).get(connector.name) is not connector:
            raise WiringError(f"{connector.name}: is not a connector of {self._kernel.name}")

    def end(self, connector: Any) -> None:
        """Take it out of force; idempotent."""
        if connector.closed:
            return
        if not isinstance(connector, Connector):
            connector.ports[0].connecting.end(connector)
            self._forget(connector)
            return
        wiring.unwire(connector)
        if not (connector.in_.is_tap or connector.out.is_tap or connector.parked):
            self.losses.end(connector)
            self.gaps.end(connector)
            self.unconverted.end(connector)
            self._forget(connector)
        if self.far is not None and connector.profile.far_end:
            self.far.connector_ended(connector)

    def _forget(self, connector: Any) -> None:
        self._those(connector).pop(connector.name, None)
        self._numbering.free(connector.name)
        self._kernel.bus.publish(Disconnected(connector.profile))

    def end_whole(self, connection: Connection[Any]) -> None:
        """Take all connectors of one `connect` out of force, the last one first.

        Raises:
            WiringError: one is of another kernel; none was ended.
            ThreadError: called in another thread than the loop's.
        """
        self._kernel.check_thread("the end of a connection")
        for connector in connection:
            self.check_mine(connector)
        self.end_each(connection[::-1])

    def end_all(self) -> None:
        """In reverse order."""
        self.early.close()
        self.end_each(tuple(self.service_connectors.values())[::-1])
        self.end_each(tuple(self.connectors.values())[::-1])
        self.losses.close()
        self.unconverted.close()

    def end_each(self, connectors: Sequence[Any]) -> None:
        """End these; one that cannot be ended does not keep the others."""
        for connector in connectors:
            guarded(f"{connector.name}: could not be ended", self.end, connector)
            if not connector.closed:
                self._kernel._faulted()


def _connecting(ports: Sequence[Any]) -> Connecting | None:
    """The maker of connectors between these; None where they are data ports."""
    those = (one.connecting for one in ports if isinstance(one, PortDeclaration))
    return next((one for one in those if one is not None), None)
