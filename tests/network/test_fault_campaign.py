"""Three kernels behind a router, and faults at random: in the end both ends of every link account for every sample."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("zenoh")

from campaign import CAMPAIGN, time_limit
from network.linked_parts import LEASE, WAIT, Linked, assert_in_order, came, ended, settings, settled
from network.network_parts import free_port
from network.proxy_parts import Proxy, proxied

FAULTS, SECONDS = (60, 600.0) if CAMPAIGN else (6, 24.0)
NAMES = "abc"
POLICIES: dict[str, dict[str, Any]] = {
    "flush": {"subscription": "flush", "full": "block", "timeout": None},
    "block": {"full": "block", "timeout": None},
    "newest": {"push": "new"},
    "short": {"length": 20},
}
"""One connector each from every kernel to the next one, and the first two to the one after it as well."""


class Network:
    """A router, three kernels that meet there, each through a proxy, and what can be done to them."""

    def __init__(self, folder: Path, chance: random.Random, stack: ExitStack) -> None:
        self._folder, self._chance, self._port = folder, chance, free_port()
        self._router: subprocess.Popen[bytes] | None = None
        self.made: dict[str, list[tuple[str, str, dict[str, Any]]]] = {}
        """By kernel: source, path of the reader, options."""
        self.proxies: dict[str, Proxy] = {}
        self.kernels: dict[str, Linked] = {}
        self.killed: Counter[str] = Counter()
        stack.callback(self.end_router)
        self.start_router()
        for name in NAMES:
            self.proxies[name] = stack.enter_context(proxied(self._port))
            after = NAMES[NAMES.index(name) - 2 :] + NAMES
            self.made[name] = [(one, f"h{after[0]}/{after[0]}/{name}_{one}.inp", POLICIES[one]) for one in POLICIES]
            self.made[name] += [
                (f"{one}2", f"h{after[1]}/{after[1]}/{name}_{one}2.inp", POLICIES[one]) for one in ("flush", "block")
            ]
        for name in NAMES:
            said = settings(
                name,
                sources=[source for source, _, _ in self.made[name]],
                sinks={one.name: one for one in self.files(name)},
                connect=self.proxies[name].address,
            )
            self.kernels[name] = Linked(said, folder / f"{name}.log")
            stack.enter_context(ended(self.kernels[name]))
        for one in NAMES:
            self.connect(one)

    def files(self, reader: str) -> list[Path]:
        """Where a kernel writes what it reads."""
        paths = [path for made in self.made.values() for _, path, _ in made]
        return [self._folder / path.rpartition("/")[2][:-4] for path in paths if path.startswith(f"h{reader}/")]

    def connect(self, name: str) -> None:
        """Have a kernel that was started connect its ports, and write."""
        kernel = self.kernels[name]
        for source, to, options in self.made[name]:
            kernel.do("connect", source=source, to=to, within=60.0, **options)
        kernel.do("write", sources=[source for source, _, _ in self.made[name]], every=0.01)

    def start_router(self) -> None:
        command = [sys.executable, "-m", "aiorts", "router", "--listen", f"127.0.0.1:{self._port}"]
        self._router = subprocess.Popen([*command, "--insecure-network"], stderr=subprocess.DEVNULL)

    def end_router(self) -> None:
        if self._router is not None:
            self._router.kill()
            self._router.wait(WAIT)

    # -- faults ----------------------------------------------------------------------------------------------------

    def kill(self, name: str) -> None:
        """A kernel is killed, and started again."""
        self.kernels[name].kill()
        self.killed[name] += 1
        time.sleep(self._chance.uniform(0.0, 2.0))
        self.kernels[name].start()
        self.connect(name)

    def stop(self, name: str) -> None:
        """A kernel stands still."""
        self.kernels[name].signal(signal.SIGSTOP)
        time.sleep(self._chance.uniform(1.0, 4.0))
        self.kernels[name].signal(signal.SIGCONT)

    def cut(self, name: str) -> None:
        """The connections of a kernel end, and there is none for a while."""
        self.proxies[name].cut()
        time.sleep(self._chance.uniform(0.0, 4.0))
        self.proxies[name].mend()

    def silence(self, name: str) -> None:
        """Nothing comes through."""
        self.proxies[name].hold("there", "back")
        time.sleep(self._chance.uniform(0.5, 2 * LEASE))
        self.proxies[name].release()

    def one_way(self, name: str) -> None:
        """What a kernel says, or what it is to hear, does not come through."""
        self.proxies[name].hold("there" if self._chance.random() < 0.5 else "back")
        time.sleep(self._chance.uniform(0.5, 2 * LEASE))
        self.proxies[name].release()

    def restart_router(self, _: str) -> None:
        """The router is killed, and started again."""
        self.end_router()
        time.sleep(self._chance.uniform(0.0, 2.0))
        self.start_router()

    def slow(self, name: str) -> None:
        """What a kernel says and hears takes its time."""
        self.proxies[name].delay = self._chance.uniform(0.02, 0.3)
        time.sleep(self._chance.uniform(1.0, 4.0))
        self.proxies[name].delay = 0.0

    def narrow(self, name: str) -> None:
        """Little of what a kernel says and hears comes through in a second."""
        self.proxies[name].rate = 20_000.0
        time.sleep(self._chance.uniform(1.0, 4.0))
        self.proxies[name].rate = 0.0

    @property
    def faults(self) -> list[Callable[[str], None]]:
        return [
            *(self.kill, self.stop, self.cut, self.silence, self.one_way, self.restart_router, self.slow, self.narrow)
        ]


@contextmanager
def network(folder: Path, chance: random.Random) -> Iterator[Network]:
    """Such a network, until the end of the block."""
    with ExitStack() as stack:
        yield Network(folder, chance, stack)


@pytest.mark.slow(kept_by="links/test_protocol.py::test_any_order_of_faults_leaves_nothing_unexplained")
@pytest.mark.fault("E03", "E08")
@pytest.mark.campaign
@pytest.mark.timeout(time_limit(1_200))
def test_after_any_faults_every_sample_is_accounted_for(tmp_path: Path) -> None:
    chance = random.Random(20)
    with network(tmp_path, chance) as net:
        for one in net.kernels.values():
            one.up(6 + 6, 60.0)
        began, done = time.monotonic(), Counter[str]()
        for number in range(FAULTS):
            pool = net.faults
            fault = pool[number % len(pool)] if number < len(pool) else chance.choice(pool)
            fault(chance.choice(NAMES))
            done[fault.__name__] += 1
            time.sleep(max(0.0, began + (number + 1) * SECONDS / FAULTS - time.monotonic()))
        again = time.monotonic()
        for one in net.kernels.values():
            one.up(6 + 6, 60.0)
        print(f"{done}: up again {time.monotonic() - again:.1f} s after the last, killed {net.killed}")
        time.sleep(1.0)
        written = {name: one.do("halt", within=60.0) for name, one in net.kernels.items()}
        assert [one["unfinished"] for one in written.values()] == [0, 0, 0]
        total: Counter[str] = Counter()
        read: dict[str, int] = {}
        ledgers = {name: settled(one) for name, one in net.kernels.items()}
        for one in net.kernels.values():
            read |= one.do("look")["read"]
        for name, found in ledgers.items():
            assert len(found) == 6
            for link, ledger in found.items():
                assert ledger["unexplained"] == 0, (link, ledger)
                sink = link.rpartition("/")[2][:-4]
                assert ledger["delivered"] == read[sink], (link, ledger)
                assert_in_order(tmp_path / sink)
                source = link.partition(".")[0]
                last = came(tmp_path / sink).get(written[name]["writer"], [])
                assert last, f"{link}: nothing came after the last start"
                if source.startswith(("flush", "block")):  # who waits loses what a killed reader had, and no more
                    assert ledger["dropped"].keys() <= {"unknown_fate"}, (link, ledger)
                assert len(last) <= written[name]["written"][source]
                total["written"] += ledger["written"]
                total["read"] += ledger["delivered"]
                total["before"] += ledger["acknowledged_before"]
                for reason, count in ledger["dropped"].items():
                    total[reason] += count
        print(total)
