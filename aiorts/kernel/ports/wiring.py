"""Connecting ports: every check that may refuse runs here, before anything is changed.

Either all connectors of one `connect` come into being or none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from threading import get_ident
from typing import TYPE_CHECKING, Any, TypeVar, cast

from aiorts.errors import WiringError
from aiorts.kernel.ports import InPort, OutPort, Port
from aiorts.kernel.ports.connector import Connector, unread_of
from aiorts.kernel.ports.features import PLAIN, features_of, fit_receiver, settles
from aiorts.kernel.ports.in_port import in_ports_at
from aiorts.kernel.ports.last_sample import offer_last
from aiorts.kernel.ports.port import check_room
from aiorts.model.options import SERVICE_KEYS, PortLimits, connector_profile
from aiorts.model.ordering import ordered
from aiorts.model.policy import Push, Stamp, Subscription
from aiorts.model.profile import ConnectorProfile
from aiorts.model.timing import ConnectorTimes
from aiorts.model.values import shown

if TYPE_CHECKING:
    from aiorts.kernel.ports.host import KernelSide
    from aiorts.kernel.ports.receiver import Receiver
    from aiorts.kernel.ports.transport import Transport
    from aiorts.model.converter import Converter

T = TypeVar("T")


def plan(
    kernel: KernelSide, ports: Sequence[Port[Any]], options: Mapping[str, Any]
) -> list[tuple[OutPort[Any], InPort[Any], ConnectorProfile]]:
    """The connectors to make, fully checked: each out-port with each in-port.

    Raises:
        WiringError: says which ports do not go together and why.
    """
    outs = [port for port in ports if isinstance(port, OutPort)]
    ins = [port for port in ports if isinstance(port, InPort)]
    where = " -> ".join(getattr(port, "path", None) or shown(port) for port in ports)
    if len(outs) + len(ins) != len(ports) or not outs or not ins:
        raise WiringError(f"{where or 'connect()'}: expected at least one out-port and one in-port")
    for port in ports:
        _check_alive(kernel, port)
    paths = tuple(port.path for port in ports)
    for key in options:
        if key.partition(".")[0] in SERVICE_KEYS:
            raise WiringError(f"{where}: {key}: is an option of service ports, these are data ports")
    base, limits = connector_profile(where, options, "", paths)
    allow = limits.allow_duplicate
    pairs = [(out, in_) for out in outs for in_ in ins]
    seen: set[tuple[OutPort[Any], InPort[Any]]] = set()
    for out, in_ in pairs:
        _check_pair(out, in_, base)
        if allow:
            continue
        if (out, in_) in seen or _connected(out, in_):
            far = ", here or from the other kernel, and one of the two is enough" if out.is_far or in_.is_far else ""
            raise WiringError(
                f"{out.path} -> {in_.path}: connected already{far}; the option allow_duplicate lets there be a second"
            )
        seen.add((out, in_))
    _check_stamp(base, pairs)
    for out, in_ in pairs:
        check_features(out, in_, _ended(out, in_, base))
    for port, count in Counter(port for pair in pairs for port in pair).items():
        check_limit(port, count, limits)
    profiles: dict[int | None, ConnectorProfile] = {None: base}
    for in_ in ins:
        if in_.length is not None and in_.length not in profiles:
            profiles[in_.length], _ = connector_profile(where, options, "", paths, in_.length)
    return [(out, in_, _between(out, in_, profiles[in_.length])) for out, in_ in pairs]


def wire(kernel: KernelSide, out: OutPort[Any], in_: InPort[Any], profile: ConnectorProfile) -> Connector:
    """Make the connector and add it to both ports."""
    hosts = [host for host in (out._host, in_._host) if host is not None]
    if any(host.locked for host in hosts):
        in_._make_locked()
    for host in hosts:
        if host.prepare is not None:
            host.prepare(in_)
    receiver = in_._receiver
    connector = Connector(profile, out, in_)
    connector._transport = PLAIN.of(profile)(connector, receiver, kernel)
    receiver.fit(connector._transport)
    several = receiver.tokens is not None
    # The kernel's number object is shared: each call of `get_ident` makes a new object of 32 bytes.
    receiver.thread = kernel.thread_id or get_ident()
    alone = (connector,)  # one object for both ends, where neither has another
    before = in_.connectors  # without those of services, which come last
    with receiver.guard():
        in_._connectors = before + alone + in_._connectors[len(before) :]
        receiver.read_stamps += profile.stamp is Stamp.READ
        if settles(profile):
            receiver = fit_receiver(in_)
        receiver.refresh()
    shown = out.connectors  # without taps, which come last
    out._connectors = shown + alone + out._connectors[len(shown) :]
    _refresh_writers(out, receiver, several)
    if profile.keep_last:
        offer_last(connector, 0)
    return connector


def unwire(connector: Connector) -> None:
    """Remove the connector from both ports: its queued samples are dropped, writers that wait go on."""
    out, in_ = connector.out, connector.in_
    if not connector.parked:
        out._connectors = _without(out._connectors, connector)
    receiver = in_._receiver
    several = receiver.tokens is not None
    with receiver.guard():
        unread = unread_of(connector)
        connector._transport.close()
        in_._connectors = _without(in_._connectors, connector)
        receiver.read_stamps -= connector.profile.stamp is Stamp.READ
        if several and unread:
            receiver.settle_tokens()
        if settles(connector.profile):
            receiver = fit_receiver(in_)
        receiver.refresh()
    _refresh_writers(out, receiver, several)
    receiver.connector_ended()


def park(connector: Connector) -> None:
    """Stop all writes to a connector; unread samples can be read, and samples that wait for room are moved in."""
    out, in_, transport = connector.out, connector.in_, connector._transport
    with transport.guard():
        transport.admit_all()
        connector.parked = True
        out._connectors = _without(out._connectors, connector)
        in_._connectors = (*_without(in_._connectors, connector), connector)
        in_._receiver.refresh()
    out._refresh()


def unpark(connector: Connector) -> None:
    """End the parking of a connector: samples are written to it again."""
    out, in_ = connector.out, connector.in_
    with connector._transport.guard():
        in_._connectors = _after(in_.connectors, connector, _without(in_._connectors, connector))
        connector.parked = False
        in_._receiver.refresh()
    out._connectors = _after(out.connectors, connector, out._connectors)
    out._refresh()


def arrange(port: Port[Any], connectors: Sequence[Connector]) -> None:
    """Put these connectors of a data port in this order; the port's other connectors follow."""
    shown = port.connectors
    line = tuple(ordered(shown, connectors))
    if line == shown:
        return
    if isinstance(port, InPort):
        with port._receiver.guard():
            port._connectors = line + port._connectors[len(shown) :]
            port._receiver.refresh()
    elif isinstance(port, OutPort):
        port._connectors = line + port._connectors[len(shown) :]
        port._refresh()


def renewed_profile(connector: Connector, options: Mapping[str, Any]) -> ConnectorProfile:
    """The profile of a connector with other options, checked as for a new connector.

    Raises:
        WiringError: says what does not go together and why.
    """
    out, in_ = connector.out, connector.in_
    where = f"{out.path} -> {in_.path}"
    length = () if in_.length is None else (in_.length,)
    profile, _ = connector_profile(where, options, connector.name, (out.path, in_.path), *length)
    profile = replace(_between(out, in_, profile), name=connector.name)
    _check_pair(out, in_, profile)
    _check_stamp(profile, [(out, in_)])
    check_features(out, in_, profile)
    return profile


def renew(kernel: KernelSide, connector: Connector, profile: ConnectorProfile) -> None:
    """Give the connector any other options; unread samples and those that wait for room are kept, in order.

    No real-time thread is at the connector.
    """
    out, in_, old = connector.out, connector.in_, connector._transport
    kind = type(old).kind
    with old.guard():
        if kind is not PLAIN:
            old.replace(PLAIN, in_._receiver)
            old = connector._transport
        old.settle()
        old.admit_all()
        old.share(False, out._sent)
        old.count_displaced()
        receiver = in_._receiver
        receiver.read_stamps += (profile.stamp is Stamp.READ) - (connector.profile.stamp is Stamp.READ)
        connector.profile = profile
        receiver = fit_receiver(in_)
        new = connector._transport = PLAIN.of(profile)(connector, receiver, kernel)
        receiver.exchange(old, new)
        new.carry_on(old)
        keep_newest(new)
        if kind is not PLAIN:
            new.replace(kind, receiver)
        receiver.refresh_all()
    out._refresh()


def keep_newest(transport: Transport) -> None:
    """Drop unread samples but the newest as superseded, if the reader gets only that; the caller holds the lock."""
    queue, periodic = transport.queue, transport.connector.profile.subscription is Subscription.PERIODIC
    if len(queue) > 1 and transport.push is Push.NEW and not periodic:
        newest = queue.pop()
        transport.drop_these("superseded", queue)
        queue.clear()
        queue.append(newest)
        transport.receiver.settle_tokens()


def measure(connector: Connector, count: int) -> None:
    """Keep the times of the last `count` sends and reads from now on, 0: none; unread samples and waiting tasks stay.

    No real-time thread is at the connector.
    """
    transport = connector._transport
    with transport.guard():
        now_ns = transport.clock.monotonic_ns()
        connector.profile = replace(connector.profile, measure=count)
        transport.times = ConnectorTimes(count, now_ns, transport.total()) if count else None
        receiver = fit_receiver(connector.in_)
        transport.replace(type(transport).kind, receiver)
        receiver.refresh_all()


def _refresh_writers(out: OutPort[Any], receiver: Receiver, several: bool) -> None:
    """Choose write paths again: of `out`, and of all writers to its reader if `receiver` gained or lost its tokens."""
    out._refresh()
    if several is (receiver.tokens is None):
        receiver.refresh_writers()


def _after(shown: tuple[Connector, ...], one: Connector, those: tuple[Connector, ...]) -> tuple[Connector, ...]:
    """The connectors `those` with `one` put behind those that are shown and before the hidden ones."""
    return (*shown, one, *those[len(shown) :])


def _without(those: tuple[T, ...], one: T) -> tuple[T, ...]:
    """The connectors without `one`, mostly the first or the last: many connectors end in order, or in reverse order."""
    if those[-1] == one:
        return those[:-1]
    index = those.index(one)
    return those[:index] + those[index + 1 :]


def _check_alive(kernel: KernelSide, port: Port[Any]) -> None:
    host = port._host
    if host is None or host.kernel is not kernel:
        whose = "is a declaration" if host is None else "belongs to another kernel, or to none yet"
        raise WiringError(
            f"{port.path or repr(port)}: {whose}; connect the ports of components that were added to this kernel"
        )
    if port._removed():
        raise WiringError(f"{port.path}: this port or its component was removed")


def _connected(out: OutPort[Any], in_: InPort[Any]) -> bool:
    # The side with fewer connectors is searched: the other may have a thousand.
    if len(out.connectors) <= len(in_.connectors):
        return any(connector.in_ is in_ for connector in out.connectors)
    return any(connector.out is out for connector in in_.connectors)


def _check_pair(out: OutPort[Any], in_: InPort[Any], profile: ConnectorProfile) -> None:
    for fault in pair_faults(out, in_, converted=profile.convert is not None):
        raise WiringError(fault)


def _between(out: OutPort[Any], in_: InPort[Any], profile: ConnectorProfile) -> ConnectorProfile:
    """The options of a connector; a converter that they name is fitted to the two types, and `far_end` is set."""
    if profile.convert is not None:
        profile = replace(profile, convert=converter_between(out, in_, profile.convert))
    return _ended(out, in_, profile)


def _ended(out: OutPort[Any], in_: InPort[Any], profile: ConnectorProfile) -> ConnectorProfile:
    """The options of a connector, with `far_end` set to the end that is in another kernel, if any."""
    if not (out.is_far or in_.is_far):
        return profile
    return replace(profile, far_end="reader" if in_.is_far else "writer")


def converter_between(out: OutPort[Any], in_: InPort[Any], converter: str) -> str:
    """The converter for a connector of these two ports.

    Raises:
        WiringError: the converter does not fit between the two types.
    """
    try:
        return cast("Converter", converter).between(out.type, in_.type)
    except WiringError as error:
        raise WiringError(f"{out.path} -> {in_.path}: convert = {converter}: {error}") from error.__cause__


def pair_faults(out: OutPort[Any], in_: InPort[Any], *, converted: bool = False) -> Iterator[str]:
    """The reasons why `in_` cannot take the samples of `out`; none if they fit or are converted."""
    if converted:
        return
    where = f"{out.path} -> {in_.path}"
    if not issubclass(out.type, in_.type):
        from aiorts.types import type_name
        from aiorts.types.structure import has_single_values

        single = has_single_values(out.type) and has_single_values(in_.type)
        between = "a FlexiFilter" if single else "a component of your own"
        yield (
            f"{where}: types differ: {out.path} sends {type_name(out.type)}, {in_.path} takes {type_name(in_.type)}; "
            f"connect ports of one type, or put {between} between them, or give convert = a function"
        )
    for field, sent, taken in _unlike_units(out, in_):
        of = f" of {field}" if field else ""
        yield (
            f"{where}: units{of} differ: {out.path} sends {sent!r}, {in_.path} takes {taken!r}; "
            "declare one unit at both, or give convert = a function"
        )
    if out.shape is not None and in_.shape is not None and not _shapes_agree(out.shape, in_.shape):
        yield (
            f"{where}: shapes differ: {out.path} sends {out.shape}, {in_.path} takes {in_.shape}; "
            "declare one shape at both, or give convert = a function"
        )


def _unlike_units(out: OutPort[Any], in_: InPort[Any]) -> Iterator[tuple[str, str, str]]:
    """Each field to which the two ports give different units, with both units; "" is the data as a whole."""
    from aiorts.types.structure import sole_unit, units_of

    sent, taken = out.unit or sole_unit(out.type), in_.unit or sole_unit(in_.type)
    if sent and taken:
        if sent != taken:
            yield "", sent, taken
    elif out.type is not in_.type:  # a subclass of the reader's type, which may give a field another unit
        theirs = units_of(in_.type)
        for field, unit in units_of(out.type).items():
            if theirs.get(field, unit) != unit:
                yield field, unit, theirs[field]


def _shapes_agree(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return len(one) == len(other) and all(a == b or -1 in (a, b) for a, b in zip(one, other, strict=True))


def _check_stamp(profile: ConnectorProfile, pairs: Sequence[tuple[OutPort[Any], InPort[Any]]]) -> None:
    from aiorts.types import has_tm

    if profile.stamp is None:
        return
    for out, in_ in pairs:
        carried = out.type if profile.convert is None else in_.type
        if not has_tm(carried):
            raise WiringError(
                f"{out.path} -> {in_.path}: stamp = {Stamp(profile.stamp)}: "
                f"{carried.__name__} has no field tm to put it in"
            )


def check_features(out: OutPort[Any], in_: InPort[Any], profile: ConnectorProfile) -> None:
    """Raise WiringError when a real-time thread would use an in-port with an option that such a thread cannot have."""
    found = _kept_from_threads(profile)
    reached = [in_._host, *(connector.out._host for connector in in_._connectors)] if found else [in_._host]
    threads = [host.name for host in (out._host, *reached) if host is not None and host.prepare is not None]
    if threads and (fault := _featured(in_, profile)):
        raise WiringError(
            f"{out.path} -> {in_.path}: {fault}, and {threads[0]} runs in a real-time thread, which has no such "
            f"connector at its ports; leave that option out, or run {threads[0]} in another kind of context"
        )


def realtime_fault(port: Port[Any]) -> str:
    """The reason why no real-time thread can use this port; "" if a real-time thread can."""
    return next(filter(None, (_featured(in_) for in_ in in_ports_at(port))), "")


def _featured(in_: InPort[Any], *more: ConnectorProfile) -> str:
    for profile in (*more, *(connector.profile for connector in in_._connectors)):
        for key in _kept_from_threads(profile):
            return f"{profile.name or in_.path} has {key}"
    return ""


def _kept_from_threads(profile: ConnectorProfile) -> list[str]:
    """The options of a connector with which no real-time thread may use it."""
    return [feature.key for feature in features_of(profile) if not feature.lock_free] + [
        "keep_last"
    ] * profile.keep_last


def check_limit(port: Port[Any], more: int, limits: PortLimits) -> None:
    """Raise WiringError if a port cannot take `more` connectors, by its own limit or these limits."""
    fan = limits.fan_out if isinstance(port, OutPort) else limits.fan_in
    limit = limits.connection_limit
    candidates = [fan, limit if limit is not None and limit >= 0 else None, port.max_connectors]
    allowed = [candidate for candidate in candidates if candidate is not None]
    check_room(port, more, min(allowed, default=None))
