"""Limits of what a peer may ask: one beyond them is cut off for a while, and nobody else notices."""

from __future__ import annotations

import asyncio
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")

from aiorts import Component, InPort, Kernel, OutPort
from aiorts.guide.contents import page
from aiorts.links import Links
from aiorts.types import TimedLong
from aiorts_zenoh import Network
from aiorts_zenoh.gate import Gate
from aiorts_zenoh.limits import CUT_OFF, LIMITS, NAMES, OF_KERNEL, SLOW_NS, SLOW_NS_PER_BYTE, Limits, Names
from campaign import CAMPAIGN
from network.network_parts import free_port

HOSTILE = Path(__file__).with_name("hostile_program.py")
STEPS = st.lists(st.tuples(st.floats(0, 3), st.sampled_from(("a", "b"))), min_size=1, max_size=300)


@given(STEPS, st.sampled_from(("bad", "slow")))
def test_who_is_within_its_limit_is_never_cut_off_and_who_is_beyond_it_is(
    steps: list[tuple[float, str]], what: str
) -> None:
    limit, limits, now = LIMITS[what], Limits(), 0.0
    done: dict[str, list[float]] = {"a": [], "b": []}
    for pause, who in steps:
        now += pause / 10
        if not limits.admits(who, now):
            continue
        done[who].append(now)
        limits.count(who, what, now)
        cut = not limits.admits(who, now)
        since = [at for at in done[who] if at > now - limit.seconds]
        if cut:
            assert len(since) > limit.most
            assert not limits.admits(who, now + CUT_OFF - 0.01)
            done[who].clear()  # it begins anew
        # Twice as many in that time cannot have leaked away.
        assert cut or len(since) <= 2 * limit.most


def test_the_guide_names_these_limits() -> None:
    found = page("connect-hosts")
    assert found is not None
    text = " ".join(found.text.split())
    (said,) = re.findall(
        r"is not heard for (\d+) seconds.* are (\d+) questions a second, over ten seconds, and ([\d,]+) more once; "
        r"(\d+) messages a minute that are none; and (\d+) messages a minute that take the processor longer than "
        r"(\d+) ms, and (\d+) ms more for each megabyte\. A kernel declares two tokens, "
        r"its presence in the network: of one host ([\d,]+) are seen, of one kernel's name ([\d,]+) on all hosts "
        r"together\.",
        text,
    )
    question, bad, slow = (LIMITS[what] for what in ("question", "bad", "slow"))
    assert (question.seconds, bad.seconds, slow.seconds) == (10.0, 60.0, 60.0)
    assert [int(one.replace(",", "")) for one in said] == [
        *(CUT_OFF, question.most / 10, question.at_first, bad.most, slow.most),
        *(SLOW_NS / 1e6, SLOW_NS_PER_BYTE, NAMES, OF_KERNEL),
    ]


def test_it_is_said_once_and_over_after_a_while() -> None:
    limits = Limits()
    said = [limits.count("evil", "bad", 5.0) for _ in range(LIMITS["bad"].most + 1)]
    assert said[:-1] == [""] * LIMITS["bad"].most
    assert said[-1] == "evil is beyond 100 messages a minute that are none, and is not heard for 10 s"
    assert not limits.admits("evil", 14.9)
    assert limits.admits("good", 14.9)
    assert limits.admits("evil", 15.1)
    assert [text for _ in range(500) if (text := limits.count("evil", "bad", 15.1))] == []  # cut off again, said before


@pytest.mark.slow(kept_by="test_it_is_said_once_and_over_after_a_while")
def test_a_table_of_peers_that_are_made_up_has_a_bound() -> None:
    limits = Limits()
    for number in range(30_000):
        for _ in range(1 + LIMITS["slow"].most):
            limits.count(f"peer{number}", "slow", 1.0)
    assert len(limits.cut_off) == 10_000


@given(st.lists(st.tuples(st.integers(0, 30), st.booleans()), max_size=200))
def test_names_that_are_taken_are_those_that_are_there(steps: list[tuple[int, bool]]) -> None:
    names, there = Names(), set()
    for number, up in steps:
        taken = names.admits("host", "robot", f"token{number}", up=up)
        assert taken == (up or number in there)
        (there.add if up else there.discard)(number)


def test_of_more_names_than_one_host_may_have_the_rest_is_left_out_and_others_are_not() -> None:
    names = Names()
    taken = [names.admits("evil", f"k{number}", f"token{number}", up=True) for number in range(NAMES + 5)]
    assert taken == [True] * NAMES + [False] * 5
    assert names.beyond("evil", "k") == ("host", "evil")
    assert names.admits("good", "k", "token", up=True)
    assert not names.admits("evil", "k", f"token{NAMES + 1}", up=False)
    assert names.admits("evil", "k0", "token0", up=False)
    assert names.admits("evil", "k", f"token{NAMES + 1}", up=True)


def test_of_one_kernels_name_only_so_many_tokens_are_seen_on_all_hosts_and_others_as_ever() -> None:
    names = Names()
    taken = [names.admits(f"host{number}", "evil", f"token{number}", up=True) for number in range(OF_KERNEL + 5)]
    assert taken == [True] * OF_KERNEL + [False] * 5
    assert names.beyond("host0", "evil") == ("kernel", "evil")
    assert names.admits("host0", "good", "token", up=True)
    assert [names.admits(f"host{number}", "evil", f"token{number}", up=False) for number in range(OF_KERNEL)] == taken[
        :OF_KERNEL
    ]
    assert names.beyond("host0", "evil") is None


def test_what_has_too_many_tokens_is_said_once_and_again_when_it_had_none() -> None:
    said: list[str] = []
    gate, base = Gate(lambda name: False, said.append), "aiorts/1/default/live/host"
    for _ in range(2):
        for number in range(OF_KERNEL + 5):
            gate.token(f"{base}/evil/{number}", up=True)
        for number in range(OF_KERNEL):
            gate.token(f"{base}/evil/{number}", up=False)
    assert said == [f"zenoh: the kernel evil has {OF_KERNEL} tokens and more; the rest is not seen"] * 2


def test_kernels_of_one_name_on_several_hosts_are_limited_each() -> None:
    said: list[str] = []
    gate = Gate({"one/robot", "two/robot"}.__contains__, said.append)
    question = "aiorts/1/default/svc/station/hub/00/robot/offer"
    for _ in range(LIMITS["question"].most + LIMITS["question"].at_first + 50):
        gate.question(question, bytes(16) + b"one/robot")
    assert gate.cut_off == ("one/robot",)
    assert gate.question(question, bytes(16) + b"two/robot")
    assert not gate.message("aiorts/1/default/link/one/robot/station/hub/1/w")
    assert gate.message("aiorts/1/default/link/two/robot/station/hub/1/w")
    assert gate.message("aiorts/1/default/link/station/hub/two/robot/1/r")
    assert len(said) == 1


def test_a_message_may_take_10_ms_and_longer_only_where_it_is_long() -> None:
    gate, key = Gate({"one/robot"}.__contains__, [].append), "aiorts/1/default/link/one/robot/station/hub/1/w"
    for _ in range(10):
        gate.took(key, 64 << 20, 20 * SLOW_NS)
        gate.took(key, 10, SLOW_NS)
    assert gate.cut_off == ()
    for _ in range(LIMITS["slow"].most + 1):
        gate.took(key, 10, 2 * SLOW_NS)
    assert gate.cut_off == ("one/robot",)


class Source(Component):
    out = OutPort(TimedLong)


class Sink(Component):
    inp = InPort(TimedLong, length=1_000)


@pytest.mark.slow(kept_by="test_kernels_of_one_name_on_several_hosts_are_limited_each")
@pytest.mark.fault("E21")
def test_a_flood_of_one_peer_is_cut_off_and_a_link_at_1_khz_loses_nothing(caplog: pytest.LogCaptureFixture) -> None:
    count = 4_000 if CAMPAIGN else 2_000

    async def main() -> tuple[Any, list[int], Any, float]:
        address = f"127.0.0.1:{free_port()}"
        far = {"zenoh": {"listen": address, "host": "station", "insecure": True}}
        near = {"zenoh": {"connect": address, "host": "near", "insecure": True}}
        async with Kernel("hub", services=far) as reader, Kernel("writer", services=near) as writer:
            sink, source = await reader.add(Sink("sink")), await writer.add(Source("source"))
            connector = await writer.connect(source.out, "station/hub/sink.inp", length=10_000)
            came: list[int] = []

            async def read() -> None:
                while len(came) < count:
                    came.append((await sink.inp.read(timeout=20.0)).tm)

            async def evil_is_cut_off() -> float:
                asked = time.monotonic()
                while "evil" not in str(reader.service(Network).report()["cut_off"]):
                    await asyncio.sleep(0.01)
                return time.monotonic() - asked

            reading = asyncio.ensure_future(read())
            links = writer.service(Links)
            async with asyncio.timeout(10.0):
                while not (found := [one for one in links.peers if one.host == "station"]):
                    await asyncio.sleep(0.01)
            hub = found[0]
            hostile = subprocess.Popen([sys.executable, str(HOSTILE), address, f"station/hub/{hub.epoch:016x}"])
            try:
                noticing = asyncio.ensure_future(evil_is_cut_off())
                for number in range(count):
                    source.out.write_nowait(TimedLong(number, number))
                    await asyncio.sleep(0.001)
                await asyncio.wait_for(reading, 30.0)
                seconds = await asyncio.wait_for(noticing, 30.0)
                ledger = await writer.service(Links).ledger(connector)
                return ledger, came, reader.service(Network).report(), seconds
            finally:
                hostile.kill()
                hostile.wait(10)

    ledger, came, report, _ = asyncio.run(main())
    assert came == list(range(count))
    assert (ledger.written, ledger.delivered, ledger.unexplained) == (count, count, 0)
    assert sum("evil" in name for name in report["kernels"]) <= NAMES
    lines = [one.getMessage() for one in caplog.records if "evil" in one.getMessage()]
    assert 1 <= len([one for one in lines if "is not heard for 10 s" in one]) <= 2, lines  # by host, and by name alone
