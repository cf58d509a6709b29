"""What each role may declare and send, a test for each cell, with real engines and certificates.

The other end is a component that asks for everything (`open_ears`) and takes what its table lets in.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

import zenoh

from network.certificate_parts import folder
from network.engine_parts import BASE, session
from network.network_parts import free_port

pytestmark = pytest.mark.slow(
    kept_by="network/test_access.py::test_what_a_name_may_send_is_its_own_and_forged_names_are_not"
)

WAIT = 10.0
NAMES = {"anna": "viewer", "otto": "operator", "camera": "component", "lead": "coordinator"}
"""Who sends, each of another role."""
OTHERS = {"arm": "component", "base": "component", "eve": "operator"}
"""Who receives, and names that are another's."""
LOOKS, OPERATES = {"viewer", "operator", "coordinator"}, {"operator", "coordinator"}
KERNELS = {"component", "coordinator"}


class Cell(NamedTuple):
    """A key, with {a} for who sends and {n} for a number, who may send what there, and whether it names another."""

    key: str
    message: str
    roles: set[str]


def _cells() -> Iterator[tuple[str, Cell]]:
    """Each key with the messages that may have it; each also with the other messages, and with names of others."""
    own = {
        "token of a kernel": ("live/host/{a}/1-{n}-{n}", {"token": KERNELS}),
        "token of an owner": ("live/host/{a}/1-{n}-{n}/own", {"token": KERNELS}),
        "told of names": ("heard/host/arm/{n}/{a}", {"put": KERNELS}),
        "told that it is revoked": ("denied/arm/{a}", {"token": KERNELS}),
        "question": ("svc/host/arm/{n}/{a}/offer", {"query": KERNELS}),
        "frame of a writer": ("link/host/{a}/host/arm/{n}/w", {"put": KERNELS}),
        "frame of a reader": ("link/host/arm/host/{a}/{n}/r", {"put": KERNELS}),
        "look": ("info/host/arm/{n}/{a}/names", {"query": LOOKS, "put": LOOKS, "token": LOOKS}),
        "order": ("ctl/host/arm/{n}/{a}/stop", {"query": OPERATES, "put": OPERATES, "token": OPERATES}),
        "another domain": ("../else/live/host/{a}/1-{n}-{n}", {}),
    }
    for what, (key, allowed) in own.items():
        for message in ("token", "put", "query"):
            yield f"{what}-{message}", Cell(key, message, allowed.get(message, set()))
            for other in ("base", "eve"):
                yield f"{what} as {other}-{message}", Cell(key.replace("{a}", other), message, set())
    # To whom it goes is in the key, too: what is for another does not come here.
    for what, key, message in (
        ("told of names, to another", "heard/host/base/{n}/{a}", "put"),
        ("told that another is revoked", "denied/base/{a}", "token"),
        ("question to another", "svc/host/base/{n}/{a}/offer", "query"),
        ("frame to another", "link/host/{a}/host/base/{n}/w", "put"),
        ("token of a name that begins alike", "live/host/{a}2/1-{n}-{n}", "token"),
        ("token of any name", "live/host/*/1-{n}-{n}", "token"),
        ("question as anybody", "svc/host/arm/{n}/*/offer", "query"),
    ):
        yield what, Cell(key, message, set())


CELLS = dict(_cells())
HONEST = {"kernel": ("live/host/{a}/2-{n}-{n}", "link/host/{a}/host/arm/{n}/w", "svc/host/arm/{n}/{a}/offer")}
HONEST |= {"client": ("info/host/arm/{n}/{a}/live", "info/host/arm/{n}/{a}/c", "info/host/arm/{n}/{a}/names")}
"""A key at which a role may send a token, a put and a query: what is sent there last says that all before has come."""
HEARS = {
    "heard/host/{a}/{n}/arm": KERNELS,
    "link/host/arm/host/{a}/{n}/w": KERNELS,
    "link/host/{a}/host/arm/{n}/r": KERNELS,
    "info/host/arm/{n}/{a}/c/s": LOOKS,
    "ctl/host/arm/{n}/{a}/c/s": OPERATES,
}
"""What each role may hear from the component."""


class Ends:
    """A component that listens, and one session for each role."""

    def __init__(self, path: Path) -> None:
        self._stack, self._numbers = ExitStack(), itertools.count(1)
        made, address = folder(path, **NAMES, **OTHERS), f"127.0.0.1:{free_port()}"
        within = self._stack.enter_context
        self.arm = within(session(made, "arm", guarded=True, open_ears=True, listen=address))
        self._came: set[tuple[str, str]] = set()
        self._changed = threading.Condition()
        heard, remote = zenoh.handlers.Callback, {"allowed_origin": zenoh.Locality.REMOTE}
        self._kept: list[Any] = [
            self.arm.declare_subscriber("**", heard(self._note("put"), indirect=False), **remote),
            self.arm.declare_queryable("**", heard(self._note("query"), indirect=False)),
            self.arm.liveliness().declare_subscriber("**", heard(self._note("token"), indirect=False)),
        ]
        self.senders = {name: within(session(made, name, guarded=False, connect=address)) for name in NAMES}

    def close(self) -> None:
        self._stack.close()

    def _note(self, what: str) -> Callable[[Any], None]:
        def came(one: Any) -> None:
            if getattr(one, "kind", zenoh.SampleKind.PUT) == zenoh.SampleKind.PUT:
                with self._changed:
                    self._came.add((what, str(one.key_expr)))
                    self._changed.notify_all()

        return came

    def key(self, key: str, name: str) -> str:
        """A key that nothing was sent at before, where it has a number."""
        number = f"{next(self._numbers):016x}"
        return f"{BASE}/{key.format(a=name, n=number)}".replace("/default/../", "/")

    def comes(self, name: str, message: str, key: str, honest: str) -> bool:
        """Whether it comes, when something honest of the same kind has come that was sent after it."""
        with self._changed:
            self._came.clear()
        until, kept = time.monotonic() + WAIT, [send(self.senders[name], message, key)]
        while not self._has(honest):
            assert time.monotonic() < until, "what is honest does not come"
            kept.append(send(self.senders[name], message, honest))  # again: who subscribes may not be known yet
            with self._changed:
                self._changed.wait(0.1)
        for token in kept:
            if token is not None:
                token.undeclare()
        return self._has(key)

    def _has(self, key: str) -> bool:
        with self._changed:
            return any(came == key for _, came in self._came)

    def hears(self, name: str, key: str, marker: str) -> bool:
        """Whether a session hears what the component puts at a key, when it hears what it may."""
        came: set[str] = set()
        kept = [
            self.senders[name].declare_subscriber(one, lambda found: came.add(str(found.key_expr)))
            for one in (key, marker)
        ]
        until = time.monotonic() + WAIT
        while marker not in came:
            assert time.monotonic() < until, "it does not hear what it may"
            for one in (key, marker):
                self.arm.put(one, b"x", express=True)
            time.sleep(0.02)
        for one in kept:
            one.undeclare()
        return key in came


def send(opened: Any, message: str, key: str) -> Any:
    """Send one message; what is returned has to be undeclared."""
    if message == "put":
        opened.put(key, b"x", congestion_control=zenoh.CongestionControl.BLOCK, express=True)
    elif message == "query":
        opened.get(key, lambda reply: None, payload=b"x", timeout=1.0)
    else:
        return opened.liveliness().declare_token(key)
    return None


@pytest.fixture(scope="module")
def ends(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ends]:
    made = Ends(tmp_path_factory.mktemp("certificates"))
    try:
        yield made
    finally:
        made.close()


@pytest.mark.fault("E20")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("cell", CELLS)
def test_what_a_role_may_send(ends: Ends, name: str, cell: str) -> None:
    key, message, roles = CELLS[cell]
    kind = "kernel" if NAMES[name] in KERNELS else "client"
    honest = HONEST[kind][("token", "put", "query").index(message)]
    assert ends.comes(name, message, ends.key(key, name), ends.key(honest, name)) is (NAMES[name] in roles)


@pytest.mark.fault("E20")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("own", [True, False], ids=["its own", "another's"])
@pytest.mark.parametrize("key", HEARS)
def test_what_a_role_may_hear(ends: Ends, name: str, key: str, own: bool) -> None:
    role = NAMES[name]
    marker = ends.key("link/host/arm/host/{a}/{n}/w" if role in KERNELS else "info/host/arm/{n}/{a}/c/s", name)
    wanted = own and role in HEARS[key]
    assert ends.hears(name, ends.key(key, name if own else "base"), marker) is wanted
