"""`aiorts top`: shows connectors, contexts and components of a kernel at an interval; on a terminal in place."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any, Final

import click

from aiorts import exits
from aiorts.cli.commands.live.edges import edges
from aiorts.cli.commands.live.measure.readings import Counters, counters_in, rest
from aiorts.cli.commands.live.measure.screen import Ended, Screen, usable
from aiorts.cli.commands.live.measure.table import KINDS, SORTS, Tables, View, screen_of, tables, text_of
from aiorts.cli.commands.live.showing import following_options, has_ended
from aiorts.cli.commands.live.target import Running, complete, kernels
from aiorts.cli.console.output import counted, say_line, say_now
from aiorts.cli.console.report import printed
from aiorts.errors import AbsentError, ClosedError, NoAnswerError

_TIMED: Final = 64
"""Connectors whose latency is asked for at a time: sorting the spans takes the kernel's time."""
_ASKED: Final = 64
"""Links for which the reader's kernel is asked at a time."""
_PATIENCE: Final = 5.0
_FURTHER: Final = 0.5
"""Seconds to wait for the counters (_PATIENCE), and for the answers of other kernels (_FURTHER)."""
_LATE: Final = 1.5
"""Seconds after which the screen shows that no answer has come."""
_FOOT: Final = "q quit  n r d b l sort  i reverse  / filter  0-3 tables  space pause"
_VIEWS: Final = {"0": KINDS, "1": KINDS[:1], "2": KINDS[1:2], "3": KINDS[2:]}
_ORDERS: Final = {one[0]: one for one in SORTS}


@click.command(short_help="Watch connectors, contexts and components of what runs.")
@click.argument("kernel", default="", shell_complete=complete)
@click.option(
    "--interval", type=click.FloatRange(min=0.05, max=3600.0), default=1.0, metavar="S", help="Seconds; 1 by default."
)
@click.option("--filter", "text", default="", metavar="TEXT", help="Only what has TEXT in its name.")
@click.option("--sort", type=click.Choice(SORTS), default="name", help="The greatest first; by name by default.")
@click.option("--only", type=click.Choice(KINDS), help="One of the three tables.")
@following_options("intervals", "interval")
def top(
    kernel: str,
    interval: float,
    text: str,
    sort: str,
    only: str | None,
    count: int | None,
    until: float | None,
    timeout: float,
    as_json: bool,
) -> int:
    """Watch what runs: rate, drops by reason and unread samples of each connector, latency where `measure` is on;
    lateness and overruns of each context; state and calls of each component. Without a name it is the only kernel.

    On a terminal it fills the screen. Keys: q ends; n, r, d, b, l sort by name, rate, drops, buffered, lateness, i
    turns the order round; / filters, Escape shows all again; 1, 2, 3 show one table, 0 all; space holds still; arrows
    scroll. Elsewhere, and with --once or --json, it prints the tables after each interval.

    All of it is counted anyway: no sample is taken and nothing in the kernel waits. Of a link the reader's kernel is
    asked, too, for its unread samples; "-" stands where it does not answer. In simulated time rates are per second of
    that time. It ends with the kernel.
    """
    view = View((only,) if only else KINDS, sort, text=text)
    with kernels(timeout) as found:
        running = found.kernel(kernel.rstrip("/"))
        watch = _Watch(running)
        live = not (count == 1 or as_json) and usable()
        shown = 0
        try:
            if live:
                return _Live(watch, view, interval, count, until).run()
            due = time.monotonic()
            while True:
                watch.ask(view)
                watch.await_answer()
                if watch.before is not None:
                    _print(watch, view, as_json=as_json)
                    shown += 1
                if shown == count or (until is not None and time.monotonic() >= until):
                    return exits.DONE
                due = max(due + interval, time.monotonic())
                rest(running.client, due)
        except ClosedError as error:
            return has_ended(running, error, shown, None if live else count)
        except Ended as ended:
            return exits.of_signal(ended.number)


class _Watch:
    """The last two readings of a kernel, and the calls under way."""

    def __init__(self, running: Running) -> None:
        self.name = running.name
        self.client = running.client
        self.now: Counters | None = None
        self.before: Counters | None = None
        self.asked_at: float | None = None
        """The time at which the unanswered call was sent, or None."""
        self._edges = edges(running.names)
        self._waiting: Mapping[str, int | None] = {}
        """The samples that wait at either end of each shown link, by the last answer of the other kernel."""
        self._call = self._names = self._links = 0

    def ask(self, view: View) -> None:
        """Ask for the counters; `take` has the answer."""
        timed: list[str] = []
        if self.now is not None:
            rows = view.rows(self.tables()["connectors"]) if "connectors" in view.kinds else []
            timed = [row.plain["name"] for row in rows if row.plain["measure"]][:_TIMED]
            if not self._links and (
                links := [row.plain["name"] for row in rows if row.plain["in_flight"] is not None][:_ASKED]
            ):
                self._links = self.client.begin("connectors", names=links, both_ends=True)
            if not self._names and not self._edges.keys() >= self.now["connectors"].keys():
                self._names = self.client.begin("names")  # there are new connectors
        self._call = self.client.begin("statistics", timed=timed)
        self.asked_at = time.monotonic()

    def take(self) -> bool:
        """Read the socket and take answers; returns whether the counters have come.

        Raises:
            ClosedError: the kernel has ended.
        """
        self.client.read()
        if self._names and self.client.answered(self._names):
            number, self._names = self._names, 0
            self._edges = edges(self.client.result(number))
        if self._links and self.client.answered(self._links):
            number, self._links = self._links, 0
            with suppress(AbsentError):  # a connector has ended; the next call leaves it out
                self._waiting = {one["name"]: one.get("waiting") for one in self.client.result(number)}
        if self.asked_at is None or not self.client.answered(self._call):
            return False
        self.asked_at = None
        self.before, self.now = self.now, counters_in(self.client.result(self._call))
        return True

    def await_answer(self) -> None:
        """Wait for the counters, and a little for the answers of other kernels.

        Raises:
            NoAnswerError: no counters came in time.
            ClosedError: the kernel has ended.
        """
        from select import select

        began = time.monotonic()
        while self.asked_at is not None or self._links:
            left = began + (_FURTHER if self.asked_at is None else _PATIENCE) - time.monotonic()
            if left <= 0.0:
                break
            if select([self.client], [], [], left)[0]:
                self.take()
        if self.asked_at is not None:
            raise NoAnswerError(f"{self.client.entry.address}: no answer")

    def tables(self) -> Tables:
        """The tables of the last two readings."""
        assert self.now is not None  # noqa: S101 - the kernel has answered
        return tables(self.now, self.before, self._edges, self._waiting)

    def head(self, found: Tables) -> str:
        """The head of the output: the system in one line."""
        assert self.now is not None  # noqa: S101 - as above
        wires = found["connectors"]
        rates = [row.plain["rate"] for row in wires if row.plain["rate"] is not None]
        lost = sum(sum(row.plain["dropped"].values()) for row in wires)
        parts = [
            self.name,
            f"simulated {self.now['at_ns'] / 1e9:.1f} s" if self.now["simulated"] else time.strftime("%H:%M:%S"),
            counted(len(wires), "connector"),
            f"{sum(rates):.0f} samples/s" if rates or not wires else "",
            f"{lost} dropped",
            f"{sum(row.plain['failed'] for row in found['components'])} failed",
        ]
        return "  ".join(filter(None, parts))


def _print(watch: _Watch, view: View, *, as_json: bool) -> None:
    assert watch.now is not None  # noqa: S101 - the kernel has answered
    found = watch.tables()
    if as_json:
        moment = {key: watch.now[key] for key in ("time_ns", "at_ns", "simulated")}
        rows = {kind: [dict(row.plain) for row in view.rows(found[kind])] for kind in view.kinds}
        say_line({"kernel": watch.name, **moment, **rows})
    else:
        say_now("\n".join((watch.head(found), *text_of(found, view), "")))


class _Live:
    """The live screen: it redraws and takes keys also while the kernel is slow to answer."""

    def __init__(self, watch: _Watch, view: View, interval: float, count: int | None, until: float | None) -> None:
        self._watch, self._view = watch, view
        self._interval, self._left, self._until = interval, count, until
        self._due = time.monotonic()
        self._typing = False
        """Whether keys are typed into the filter."""
        self._paused = False
        self._page = 1

    def run(self) -> int:
        """Run until q is pressed or the count or time is up; returns the exit status.

        Raises:
            ClosedError: the kernel has ended.
            Ended: a signal has come.
        """
        with Screen() as screen:
            try:
                while True:
                    self._draw(screen)
                    if screen.wait(self._watch.client.fileno(), self._seconds()) and self._watch.take():
                        self._left = None if self._left is None else self._left - (self._watch.before is not None)
                    if self._press(screen.pressed()) or self._left == 0 or self._over():
                        return exits.DONE
            except OSError:
                return exits.of_signal(1)  # the terminal has gone

    def _seconds(self) -> float:
        """Ask for counters if they are due; returns the seconds until something is due again."""
        now, watch = time.monotonic(), self._watch
        if watch.asked_at is None and now >= self._due and not self._paused:
            watch.ask(self._view)
            self._due = max(self._due + self._interval, now)
        wait = 0.5 if watch.asked_at is not None or self._paused else self._due - now
        return wait if self._until is None else min(wait, self._until - now)

    def _draw(self, screen: Screen) -> None:
        width, height = screen.size()
        self._page = max(1, height - 4)
        watch = self._watch
        silent = 0.0 if watch.asked_at is None else time.monotonic() - watch.asked_at
        if watch.now is None:
            screen.draw([f"{watch.name}  no answer yet"[:width]])
            return
        found = watch.tables()
        head = f"{watch.head(found)}{'  held still' if self._paused else ''}"
        if silent > _LATE:
            head = f"{watch.name}  no answer for {silent:.0f} s"
        view = self._view
        order = f"by {view.sort}{', turned round' if view.reverse else ''}"
        foot = f"{order}{f', filter {printed(view.text)}' if view.text else ''}  {_FOOT}"
        if self._typing:
            foot = f"filter: {printed(view.text)}_"
        screen.draw(screen_of(found, view, head, foot, width, height))

    def _over(self) -> bool:
        return self._until is not None and time.monotonic() >= self._until

    def _press(self, keys: Sequence[str]) -> bool:
        """Handle keys; returns whether one of them ends the command."""
        return any(self._heard(key) for key in keys)

    def _heard(self, key: str) -> bool:
        view = self._view
        if self._typing:
            self._type(key)
        elif key == "q":
            return True
        elif key in _ORDERS:
            self._view = replace(view, sort=_ORDERS[key], reverse=False, first=0)
        elif key in _VIEWS:
            self._view = replace(view, kinds=_VIEWS[key], first=0)
        elif key == "i":
            self._view = replace(view, reverse=not view.reverse)
        elif key == "/":
            self._typing = True
        elif key == "escape":
            self._view = replace(view, text="", first=0)
        elif key == " ":
            self._paused = not self._paused
        elif key in (steps := self._steps()):
            most = max((len(view.rows(self._rows(kind))) for kind in view.kinds), default=0)
            self._view = replace(view, first=max(0, min(most - 1, view.first + steps[key])))
        return False

    def _rows(self, kind: str) -> Any:
        return () if self._watch.now is None else self._watch.tables()[kind]

    def _steps(self) -> Mapping[str, int]:
        end = 1 << 40
        return {"up": -1, "down": 1, "page up": -self._page, "page down": self._page, "home": -end, "end": end}

    def _type(self, key: str) -> None:
        text = self._view.text
        if key in ("enter", "escape"):
            self._typing = False
            text = text if key == "enter" else ""
        elif key == "back":
            text = text[:-1]
        elif len(key) == 1:
            text += key
        self._view = replace(self._view, text=text, first=0)
