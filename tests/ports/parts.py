"""Components and a reference model for the tests of ports."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from aiorts import Component, InPort, OutPort
from aiorts.model.buffer import FullPolicy, Verdict, decide
from aiorts.model.policy import Choice, Push, Subscription, admits, choose, default_push
from aiorts.types import TimedLong
from reference_buffer import Buffer


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong)


class Both(Component):
    out = OutPort(TimedLong)
    inp = InPort(TimedLong)


def long(number: int) -> TimedLong:
    return TimedLong(0, number)


def data(samples: list[TimedLong]) -> list[int]:
    return [sample.data for sample in samples]


@dataclass(eq=False)
class ModelConnector:
    """What one connector must do, said with `Buffer` and `policy` alone."""

    options: dict[str, Any]
    start_ns: int
    ledger: Buffer[int] = field(init=False)
    backlog: deque[tuple[int, int]] = field(default_factory=deque)  # (number since the connection, sample)
    arrived: dict[int, int] = field(default_factory=dict)  # sample -> its place in the one sequence of the in-port
    closed: bool = False
    offered: int = 0
    """Of the samples written, those that the writer had written before."""

    def __post_init__(self) -> None:
        given = self.options
        self.subscription = Subscription(given["subscription"])
        push = Push(given.get("push", default_push(self.subscription)))
        self.push = Push.ALL if self.subscription is Subscription.FLUSH else push
        self.skip = int(given.get("skip", 0))
        length = given.get("length", 1 if self.push is Push.NEW else 8)
        self.ledger = Buffer(length, FullPolicy(given.get("full", "overwrite")))
        self.out_length = int(given.get("out_length", 8))

    @property
    def expected(self) -> tuple[int, int, int, dict[str, int]]:
        ledger, waiting = self.ledger, len(self.backlog)
        delivered = ledger.delivered
        assert ledger.written == delivered + sum(ledger.dropped.values()) + len(ledger.samples) + waiting
        return ledger.written, delivered, len(ledger.samples) + waiting, ledger.dropped

    def drop_all(self, reason: str) -> None:
        self.ledger.discard(reason)
        self.ledger.drop(reason, len(self.backlog))
        self.backlog.clear()


class Model:
    """What an in-port with any number of connectors must do: read in the one sequence in which samples arrived."""

    def __init__(self) -> None:
        self.connectors: list[ModelConnector] = []
        self.is_open = True
        self.last: int | None = None
        self.source: ModelConnector | None = None
        self.arrivals = 0

    @property
    def order(self) -> list[ModelConnector]:
        """For each unread sample its connector, in the order of arrival."""
        unread = [(one.arrived[sample], one) for one in self.connectors for sample in one.ledger.samples]
        return [one for _, one in sorted(unread, key=lambda entry: entry[0])]

    def write(self, connector: ModelConnector, sample: int) -> bool | None:
        """What `write_nowait` returns; None for WouldBlock."""
        ledger = connector.ledger
        if not self.is_open:
            ledger.written += 1
            ledger.drop("inactive")
            return True
        if connector.subscription is Subscription.PERIODIC:
            return self._write_periodic(connector, sample)
        if not admits(connector.push, connector.skip, ledger.written + 1 - connector.offered):
            ledger.written += 1
            ledger.drop("skipped")
            return True
        if connector.push is Push.NEW:
            ledger.discard("superseded")
        verdict = ledger.offer(sample)
        if verdict in (Verdict.STORE, Verdict.REPLACE_OLDEST):
            self._arrived(connector, sample)
        return {Verdict.WAIT: None, Verdict.REFUSE: False}.get(verdict, True)

    def _write_periodic(self, connector: ModelConnector, sample: int) -> bool:
        ledger = connector.ledger
        ledger.written += 1
        if len(connector.backlog) == connector.out_length:
            if ledger.full is FullPolicy.REJECT:
                ledger.drop("rejected")
                return False
            connector.backlog.popleft()
            ledger.drop("overwritten")
        connector.backlog.append((ledger.written - connector.offered, sample))
        return True

    def period_over(self, connector: ModelConnector) -> None:
        ledger, backlog = connector.ledger, connector.backlog
        if not backlog:
            return
        for choice in choose(connector.push, connector.skip, backlog[0][0], len(backlog)):
            if choice is not Choice.SEND:
                backlog.popleft()
                ledger.drop(choice.value)
                continue
            verdict = decide(len(ledger.samples), ledger.length, ledger.full)
            if verdict is Verdict.WAIT:
                return
            sample = backlog.popleft()[1]
            verdict = ledger.offer(sample)
            ledger.written -= 1  # it was counted when it entered the backlog
            if verdict is not Verdict.REFUSE:
                self._arrived(connector, sample)

    def _arrived(self, connector: ModelConnector, sample: int) -> None:
        self.arrivals += 1
        connector.arrived[sample] = self.arrivals

    def newest(self) -> ModelConnector | None:
        """Whose sample arrived last of all that are unread."""
        order = self.order
        return order[-1] if order else None

    def read(self) -> int | None:
        if not (order := self.order):
            return None
        connector = order[0]
        self.last, self.source = connector.ledger.take(), connector
        return self.last

    def latest(self) -> int | None:
        newest = self.newest()
        if newest is not None:
            self.last, self.source = newest.ledger.take_newest(), newest
            for connector in self.connectors:
                connector.ledger.discard("superseded")
        return self.last

    def drain(self) -> list[int]:
        taken = []
        while (sample := self.read()) is not None:
            taken.append(sample)
        return taken

    def disconnect(self, connector: ModelConnector) -> None:
        connector.drop_all("disconnected")
        connector.closed = True
        self.connectors.remove(connector)

    def set_open(self, is_open: bool) -> None:
        if self.is_open is is_open:
            return
        self.is_open = is_open
        for connector in self.connectors:
            self.take_back(connector)
            connector.drop_all("inactive")
        if is_open:
            self.last = self.source = None

    def offer_last(self, connector: ModelConnector, sample: int) -> None:
        """A sample from before the connection, or from while the reader took none."""
        ledger = connector.ledger
        if connector.options.get("keep_last") and self.is_open and not connector.expected[1]:
            ledger.written += 1
            connector.offered += 1
            ledger.samples.append(sample)
            self._arrived(connector, sample)

    def take_back(self, connector: ModelConnector) -> None:
        """It lies unread, and nothing was taken or lost: it was not written."""
        written, _, buffered, _ = connector.expected
        if connector.offered and connector.ledger.samples and written == buffered:
            connector.ledger.samples.popleft()
            connector.ledger.written -= 1
            connector.offered -= 1

    def advance(self, from_ns: int, to_ns: int) -> None:
        """Let every period in (from, to] be over, in order."""
        due: list[tuple[int, ModelConnector]] = []
        for connector in self.connectors:
            if connector.subscription is Subscription.PERIODIC:
                rate = connector.options["push_rate"]
                number = (from_ns - connector.start_ns) * rate // 1_000_000_000 + 1
                while (moment := connector.start_ns + -(-number * 1_000_000_000 // rate)) <= to_ns:
                    if moment > from_ns:
                        due.append((moment, connector))
                    number += 1
        for _, connector in sorted(due, key=lambda entry: entry[0]):
            self.period_over(connector)
