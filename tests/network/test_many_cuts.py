"""Many networks that are down for seconds or minutes: soon after each is up again the same links go on."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from campaign import CAMPAIGN, time_limit
from network.host_parts import two_hosts, wire_of
from network.linked_parts import Linked, assert_in_order, changed, ended, settings, settled

COUNT = 50 if CAMPAIGN else 2
"""Pairs of hosts, each with a network of its own."""
PAUSES = (5.0, 60.0, 600.0) if CAMPAIGN else (5.0,)
"""Seconds for which each network is down."""
APART = 1.0
"""Seconds between two cuts, and between two networks that come back."""
AGAIN = 5.0
"""Seconds until links are up again when there is a network again."""
WITHIN = 180.0 if CAMPAIGN else 30.0
"""Seconds for what many processes do at once."""
POLICIES: dict[str, dict[str, Any]] = {
    "block": {"full": "block", "timeout": None},
    "short": {"length": 5},
}
"""One connector each, from `b` to `a`."""


class Pair:
    """Two hosts with a kernel each; of one number in two who connects loses its device, of the other who listens."""

    def __init__(self, number: int, folder: Path, stack: ExitStack) -> None:
        hosts = stack.enter_context(two_hosts(number))
        self._wire = wire_of(hosts[1])
        self._folder = folder / str(number)
        self._folder.mkdir()
        at, sinks = f"10.77.0.{1 + number % 2}:7447", {name: self._folder / name for name in POLICIES}
        said_a, said_b = settings("a", sinks=sinks, listen=at), settings("b", sources=[*POLICIES], connect=at)
        self.a = Linked(said_a | {"watches": 0.1}, self._folder / "a.log", hosts[number % 2])
        self.b = Linked(said_b | {"watches": 0.1}, self._folder / "b.log", hosts[1 - number % 2])
        stack.enter_context(ended(self.a, self.b))

    def begin(self) -> None:
        """Connect, and write."""
        for name, options in POLICIES.items():
            self.b.do("connect", within=WITHIN, source=name, to=f"ha/a/{name}.inp", **options)
        for one in (self.a, self.b):
            one.up(len(POLICIES), WITHIN)
        self.write()

    def write(self) -> None:
        self.b.do("write", within=WITHIN, sources=[*POLICIES], every=0.5)

    def cut(self, pause: float, begins: float) -> float:
        """Take the network down for a while; the seconds until all links were up at both ends, when it was up again."""
        time.sleep(max(0.0, begins - time.monotonic()))
        before = [one.do("look")["ids"] for one in (self.a, self.b)]
        down = self._wire("down")
        time.sleep(down + pause - time.monotonic())
        for one in (self.a, self.b):
            assert len(changed(one.do("look"), down, "down")) == len(POLICIES)
        again, took = self._wire("up"), []
        for one in (self.a, self.b):
            one.up(len(POLICIES))
            seen = one.until(lambda seen: len(changed(seen, again, "up")) == len(POLICIES))
            took += changed(seen, again, "up").values()
        assert [one.do("look")["ids"] for one in (self.a, self.b)] == before
        return max(took)

    def account(self) -> int:
        """Write no more, and look whether each sample is accounted for; how many were left out."""
        written = self.b.do("halt", within=WITHIN)["written"]
        ledgers, read = settled(self.b, WITHIN), self.a.do("look")["read"]
        for name in POLICIES:
            ledger = ledgers[f"{name}.out-ha/a/{name}.inp"]
            assert (ledger["unexplained"], ledger["written"], ledger["delivered"]) == (0, written[name], read[name])
            assert_in_order(self._folder / name)
        assert read["block"] == written["block"]
        dropped = ledgers["short.out-ha/a/short.inp"]["dropped"]
        assert dropped.keys() <= {"overwritten"}
        return sum(dropped.values())


@contextmanager
def each(pairs: list[Pair]) -> Iterator[Callable[[Callable[[Pair], Any]], list[Any]]]:
    """What does something with all of them at once, and returns what came of each in order."""
    with ThreadPoolExecutor(len(pairs)) as pool:
        yield lambda do: list(pool.map(do, pairs))


@pytest.mark.slow(kept_by="network/test_cuts.py::test_both_ends_see_that_there_is_no_way_and_go_on_when_there_is_one")
@pytest.mark.fault("E03")
@pytest.mark.campaign
@pytest.mark.timeout(time_limit(2_400))
def test_whatever_the_pause_the_same_links_go_on_and_nothing_is_unexplained(tmp_path: Path) -> None:
    with ExitStack() as stack:
        pairs = [Pair(number, tmp_path, stack) for number in range(COUNT)]
        together = stack.enter_context(each(pairs))
        together(Pair.begin)
        late: list[tuple[float, int, float]] = []
        for pause in PAUSES:
            time.sleep(2.0)
            begins = {pair: time.monotonic() + number * APART for number, pair in enumerate(pairs)}
            took = together(lambda pair, pause=pause, begins=begins: pair.cut(pause, begins[pair]))
            time.sleep(1.0)
            left_out = together(Pair.account)
            said = f"{COUNT} up in the median {statistics.median(took):.2f} s after it, the last {max(took):.2f} s"
            print(f"down for {pause:g} s: {said}; {sum(left_out)} samples overwritten in all, 0 unexplained")
            late += [(pause, number, one) for number, one in enumerate(took) if one > AGAIN]
            together(Pair.write)
        assert late == []
