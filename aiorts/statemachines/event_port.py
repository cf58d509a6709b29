"""An in-port whose samples are events for the component's state machine; when live it is an ordinary `InPort`."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from aiorts.kernel.ports import InPort

if TYPE_CHECKING:
    from aiorts.kernel.ports.connector import Connector

T = TypeVar("T")


class EventPort(InPort[T]):
    """An in-port of a state machine: each sample is one event, and the sample is the event's data.

    The event's name is that of the connector (`fsm_event_name="stop"` at `connect`), else `event`, else the port's
    name. Events wait in the connector's buffer, under its policies, until the machine takes them. Its default length
    is 8192; further events are counted as dropped, and logged.

    Args:
        type, unit, shape, doc, name, max_connectors: see `Port`.
        event: the event's name; by default the name of the port.
    """

    __slots__ = ("event",)

    def __init__(
        self,
        type: type[T],  # noqa: A002 - the word users expect
        *,
        event: str = "",
        unit: str | None = None,
        shape: tuple[int, ...] | None = None,
        doc: str = "",
        name: str | None = None,
        max_connectors: int | None = None,
    ) -> None:
        super().__init__(type, unit=unit, shape=shape, doc=doc, name=name, max_connectors=max_connectors)
        self.event = event


def event_of(connector: Connector | None, event: str) -> str:
    """The name of an event that came through `connector` to a port whose own event name is `event`."""
    if connector is None:
        return event
    extra = connector.profile.extra
    return (extra.get("fsm_event_name") or extra.get("dataport.fsm_event_name") or event) if extra else event
