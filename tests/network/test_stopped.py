"""A kernel of another host that stands still in mid stream: others are served as before, nothing is lost silently."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from campaign import CAMPAIGN
from network.linked_parts import WAIT, Linked, assert_in_order, came, ended, settings, settled
from network.network_parts import free_port

pytestmark = pytest.mark.slow(
    kept_by="links/test_protocol.py::test_a_reader_without_room_stops_the_writer_and_loses_nothing"
)

PAUSE = 8.0
COUNT = 20_000 if CAMPAIGN else 2_000
LONGEST = 0.5
"""Seconds that a call between two that go on may take longer than before, on a machine that has other things to do."""


def worst(calls: list[Any]) -> float:
    """Seconds of the longest call, none of which failed."""
    assert [fault for _, _, fault in calls if fault] == []
    assert len(calls) > 20
    return float(max(took for _, took, _ in calls))


@pytest.mark.fault("E06")
@pytest.mark.parametrize("router", [False, True], ids=["linked with each other", "linked with a router"])
def test_a_stopped_kernel_delays_no_call_between_others(router: bool, tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    way = {"connect": address} if router else {"listen": address}
    a = Linked(settings("a", sources=["one", "two"], **way), tmp_path / "a.log")
    b = Linked(settings("b", connect=address), tmp_path / "b.log")
    c = Linked(settings("c", sinks={"k": tmp_path / "k", "l": tmp_path / "l"}, connect=address), tmp_path / "c.log")
    command = [sys.executable, "-m", "aiorts", "router", "--listen", address, "--insecure-network"]
    hub = subprocess.Popen(command, stderr=subprocess.DEVNULL) if router else None
    try:
        with ended(a, b, c):
            a.until(lambda seen: len(seen["peers"]) == 2)
            b.until(lambda seen: "ha/a" in seen["peers"])
            a.do("connect", source="one", to="hc/c/k.inp", full="block", timeout=None)
            a.do("connect", source="two", to="hc/c/l.inp")
            a.do("connect", source="asks", to="hb/b/answers.service")
            b.do("connect", source="asks", to="ha/a/answers.service")
            a.up(3)
            b.up(1)
            a.do("write", sources=["one", "two"], every=0.002, size=8_000)
            for one in (a, b):
                one.do("ask", every=0.01)
            time.sleep(3.0)
            before = [worst(one.do("asked")) for one in (a, b)]
            c.signal(signal.SIGSTOP)
            time.sleep(PAUSE)
            during = [worst(one.do("asked")) for one in (a, b)]
            c.signal(signal.SIGCONT)
            print(f"worst call: {before} s before, {during} s while one kernel stands still")
            for early, late in zip(before, during, strict=True):
                assert late < early + LONGEST
            a.up(3)
            assert a.do("halt")["unfinished"] == 0
            for ledger in settled(a).values():
                assert ledger["unexplained"] == 0
            for name in ("k", "l"):
                assert_in_order(tmp_path / name)
    finally:
        if hub is not None:
            hub.terminate()
            hub.wait(WAIT)


@pytest.mark.fault("E06")
@pytest.mark.parametrize("router", [False, True], ids=["linked with each other", "linked with a router"])
@pytest.mark.parametrize("way", ["asked", "asked in short", "answered"])
def test_a_stopped_kernel_that_was_asked_or_is_answered_much_delays_no_call_between_others(
    router: bool, way: str, tmp_path: Path
) -> None:
    """15 MB in 30 questions or answers, or 5 MB in 1,400: more than the queues of the engine and of the system take.

    A router waits a quarter of a second for room in such a queue, and meanwhile carries nothing.
    """
    address = f"127.0.0.1:{free_port()}"
    a = Linked(settings("a", **({"connect": address} if router else {"listen": address})), tmp_path / "a.log")
    b, c = (Linked(settings(name, connect=address), tmp_path / f"{name}.log") for name in "bc")
    command = [sys.executable, "-m", "aiorts", "router", "--listen", address, "--insecure-network"]
    hub = subprocess.Popen(command, stderr=subprocess.DEVNULL) if router else None
    try:
        with ended(a, b, c):
            a.until(lambda seen: len(seen["peers"]) == 2)
            b.until(lambda seen: "ha/a" in seen["peers"])
            b.do("connect", source="asks", to="ha/a/answers.service")
            a.do("connect", source="asks", to="hb/b/answers.service")
            near, far = (a, "hc/c") if way.startswith("asked") else (c, "ha/a")
            near.do("connect", source="more", to=f"{far}/gives.service")
            for one in (a, b):
                one.do("ask", every=0.01)
            near.do("ask_much", count=1, asked=1, answered=1, after=0.0)  # now they know each other
            time.sleep(2.0)
            before = [worst(one.do("asked")) for one in (a, b)]
            if way == "asked":
                c.signal(signal.SIGSTOP)
                a.do("ask_much", count=30, asked=500_000, answered=1, after=0.0)
            elif way == "asked in short":
                c.signal(signal.SIGSTOP)
                for _ in range(14):  # all at once would be too much to do for the loop, whoever is asked
                    a.do("ask_much", count=100, asked=3_700, answered=1, after=0.0)
                    time.sleep(0.1)
            else:
                c.do("ask_much", count=30, asked=1, answered=500_000, after=1.0)
                time.sleep(0.5)
                c.signal(signal.SIGSTOP)
            time.sleep(PAUSE)
            during = [worst(one.do("asked")) for one in (a, b)]
            print(f"worst call: {before} s before, {during} s while one kernel stands still")
            for early, late in zip(before, during, strict=True):
                assert late < early + (3 if router else 2) * LONGEST
    finally:
        if hub is not None:
            hub.terminate()
            hub.wait(WAIT)


@pytest.mark.fault("E06")
def test_all_that_is_written_to_a_kernel_that_stands_still_arrives_or_is_counted(tmp_path: Path) -> None:
    address = f"127.0.0.1:{free_port()}"
    policies: dict[str, dict[str, Any]] = {
        "patient": {"subscription": "flush", "full": "block", "timeout": None},
        "flush": {"subscription": "flush", "full": "block", "timeout": 1.0},
        "block": {"full": "block", "timeout": 1.0},
    }
    a = Linked(settings("a", sinks={name: tmp_path / name for name in policies}, listen=address), tmp_path / "a.log")
    b = Linked(settings("b", sources=[*policies], connect=address), tmp_path / "b.log")
    with ended(a, b):
        b.until(lambda seen: seen["peers"] == ["ha/a"])
        for name, options in policies.items():
            b.do("connect", source=name, to=f"ha/a/{name}.inp", **options)
        b.up(3)
        b.do("write", sources=[*policies], every=0.001, count=COUNT)
        a.until(lambda seen: all(count > COUNT // 20 for count in seen["read"].values()))
        a.signal(signal.SIGSTOP)
        time.sleep(PAUSE)
        a.signal(signal.SIGCONT)
        b.until(lambda seen: all(count == COUNT for count in seen["written"].values()), 60.0)
        done = b.do("halt")
        ledgers, read = settled(b), a.do("look")["read"]
    assert done["unfinished"] == 0
    for name in policies:
        ledger = ledgers[f"{name}.out-ha/a/{name}.inp"]
        refused = done["refused"].get(name, 0)  # which its writer was told
        (numbers,) = came(tmp_path / name).values()
        assert_in_order(tmp_path / name)
        assert (ledger["unexplained"], ledger["delivered"], len(numbers)) == (0, read[name], read[name]), ledger
        lost = sum(ledger["dropped"].values())
        assert COUNT - len(numbers) == lost, (name, ledger, refused)
        assert lost <= refused
        print(f"{name}: {COUNT} written, {len(numbers)} arrived, {refused} writes refused, {ledger}")
    assert ledgers["patient.out-ha/a/patient.inp"]["delivered"] == COUNT
