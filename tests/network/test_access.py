"""Who may send what: the table against a model of its own, and the engine that goes by it against forged keys."""

from __future__ import annotations

import random
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

import zenoh

from aiorts.errors import ConfigurationError
from aiorts_zenoh.security.access import Access, access_control, sends
from network.certificate_parts import folder
from network.engine_parts import BASE, Heard, session
from network.network_parts import free_port

ROLES = {
    "arm": "component",
    "base": "component",
    "camera": "component",
    "anna": "viewer",
    "otto": "operator",
    "hub": "router",
}
KERNELS = [name for name, role in ROLES.items() if role == "component"]
EPOCH = f"{7:016x}"
FORGED = ("*", "**", "arm$*", "a$*", "arm.", "Arm", "nobody")
"""What may stand in a key where the name of the sender stands."""
MESSAGES = {
    "live": ("liveliness_token",),
    "svc": ("query",),
    "link": ("put",),
    "info": ("query", "put", "liveliness_token"),
    "ctl": ("query", "put", "liveliness_token"),
}


def key_of(space: str, sender: str, receiver: str) -> str:
    """What `sender` sends to `receiver`, by the layout of the keys."""
    return {
        "live": f"{BASE}/live/host/{sender}/1700000000000000000-{EPOCH}",
        "svc": f"{BASE}/svc/host/{receiver}/{EPOCH}/{sender}/link",
        "link": f"{BASE}/link/host/{sender}/host/{receiver}/1/w",
        "info": f"{BASE}/info/host/{receiver}/{EPOCH}/{sender}/names",
        "ctl": f"{BASE}/ctl/host/{receiver}/{EPOCH}/{sender}/stop",
    }[space]


def may(role: str, space: str) -> bool:
    """Whether a name of this role sends anything of its own there."""
    return role in {"live": "component", "svc": "component", "link": "component", "ctl": "operator"}.get(
        space, "viewer operator"
    )


def allows(sender: str, receiver: str, message: str, key: str) -> bool:
    """What the table says, with the engine's own way to compare keys."""
    found = sends((sender, ROLES[sender]), (receiver, ROLES[receiver]), BASE)
    return any(kind == message and zenoh.KeyExpr(allowed).includes(zenoh.KeyExpr(key)) for kind, allowed in found)


NAMES = st.sampled_from([name for name in ROLES if name != "hub"])


@pytest.mark.row(97)
@given(NAMES, st.sampled_from(KERNELS), st.sampled_from(sorted(MESSAGES)), st.sampled_from((*ROLES, *FORGED)))
def test_what_a_name_may_send_is_its_own_and_forged_names_are_not(
    sender: str, receiver: str, space: str, said: str
) -> None:
    if sender == receiver:
        return
    key = key_of(space, said, receiver)
    wanted = said == sender and may(ROLES[sender], space)
    for message in MESSAGES[space]:
        assert allows(sender, receiver, message, key) is wanted, (sender, message, key)


@pytest.mark.slow
@given(NAMES, st.sampled_from(KERNELS), st.sampled_from(KERNELS), st.sampled_from("wr"))
def test_frames_go_between_the_two_ends_of_a_link_alone(sender: str, writer: str, reader: str, end: str) -> None:
    key = f"{BASE}/link/host/{writer}/host/{reader}/1/{end}"
    for receiver in KERNELS:
        ends = (writer, reader) if end == "w" else (reader, writer)
        if sender != receiver and writer != reader:
            assert allows(sender, receiver, "put", key) is ((sender, receiver) == ends)


@given(NAMES, NAMES, st.sampled_from((f"{BASE}/**", f"{BASE}/link/**", "**", "@/**", f"{BASE}/svc/*/*/*/**")))
def test_nobody_hears_or_answers_all(sender: str, receiver: str, key: str) -> None:
    for message in ("declare_subscriber", "declare_queryable", "put", "query", "reply", "liveliness_token", "delete"):
        assert not allows(sender, receiver, message, key)


def test_what_is_revoked_hears_that_it_is_and_nothing_else() -> None:
    table = access_control("arm", Access.of_names(ROLES, ["base"]), BASE)
    rules = {one["id"]: one["key_exprs"] for one in table["rules"]}
    (policy,) = [one for one in table["policies"] if one["subjects"] == ["base"]]
    assert {key for name in policy["rules"] for key in rules[name]} == {
        f"{BASE}/denied/base/*",
        f"{BASE}/denied/base/arm",
    }
    assert table["default_permission"] == "deny"


@pytest.mark.parametrize("name", ["", "a/b", "a*", "-a", "ä", "a" * 65, "a#b", "a\n"])
def test_a_name_that_could_be_more_than_one_part_of_a_key_is_refused(name: str) -> None:
    with pytest.raises(ConfigurationError, match="expected at most 64 letters"):
        Access.of_table({"component": [name]})


# -- the engine itself -------------------------------------------------------------------------------------------------


def send(opened: Any, message: str, key: str) -> Any:
    """Send one message; what is returned has to be kept."""
    if message == "put":
        opened.put(key, b"forged", congestion_control=zenoh.CongestionControl.BLOCK, express=True)
    elif message == "query":
        opened.get(key, lambda reply: None, payload=b"forged", timeout=5.0)
    else:
        return opened.liveliness().declare_token(key)
    return None


@pytest.mark.slow(kept_by="test_what_a_name_may_send_is_its_own_and_forged_names_are_not")
@pytest.mark.row(97)
@pytest.mark.fault("E20")
def test_of_a_thousand_forged_keys_the_engine_lets_none_through(tmp_path: Path) -> None:
    certificates = folder(tmp_path, **ROLES)
    address, chosen = f"127.0.0.1:{free_port()}", random.Random(20)
    for thief in ("camera", "anna", "otto"):
        with session(certificates, "arm", guarded=True, open_ears=True, listen=address) as arm:
            heard = Heard(arm)
            with session(certificates, thief, guarded=False, connect=address) as forger:
                time.sleep(0.5)
                kept = []
                for _ in range(334):
                    space = chosen.choice(sorted(MESSAGES))
                    whose = chosen.choice([name for name in (*ROLES, "nobody") if name != thief])
                    kept.append(send(forger, chosen.choice(MESSAGES[space]), key_of(space, whose, "arm")))
                time.sleep(0.5)
                assert (heard.counts, heard.bytes) == (Counter(), 0)
                honest = ["live", "svc", "link"] if ROLES[thief] == "component" else ["info"]
                kept += [send(forger, one, key_of(space, thief, "arm")) for space in honest for one in MESSAGES[space]]
                heard.wait(3)
                own = Counter(put=1, query=1, token=1)
                assert (heard.counts, heard.bytes) == (own, len(b"forged")), "what is its own is let through"


@pytest.mark.slow(kept_by="test_what_a_name_may_send_is_its_own_and_forged_names_are_not")
def test_a_third_name_sees_nothing_of_a_link_over_a_router_and_puts_nothing_in(tmp_path: Path) -> None:
    certificates = folder(tmp_path, **ROLES)
    address = f"127.0.0.1:{free_port()}"
    frames, forward = f"{BASE}/link/*/*/host/base/*/w", key_of("link", "arm", "base")
    with (
        session(certificates, "hub", mode="router", guarded=True, listen=address),
        session(certificates, "arm", mode="client", guarded=True, connect=address) as arm,
        session(certificates, "base", mode="client", guarded=True, connect=address) as base,
        session(certificates, "camera", mode="client", guarded=False, connect=address) as camera,
    ):
        came: list[bytes] = []
        kept = base.declare_subscriber(
            frames, zenoh.handlers.Callback(lambda one: came.append(one.payload.to_bytes()), indirect=False)
        )
        heard = Heard(camera)
        also = camera.declare_subscriber(
            frames, lambda one: came.append(b"stolen"), allowed_origin=zenoh.Locality.REMOTE
        )
        until = time.monotonic() + 10.0
        while not came and time.monotonic() < until:  # until the router knows of the reader
            arm.put(forward, b"first", express=True)
            time.sleep(0.05)
        came.clear()
        for number in range(1_000):
            arm.put(forward, b"%d" % number, congestion_control=zenoh.CongestionControl.BLOCK)
            camera.put(forward, b"forged", congestion_control=zenoh.CongestionControl.BLOCK)
        until = time.monotonic() + 10.0
        while len(came) < 1_000 and time.monotonic() < until:
            time.sleep(0.01)
        time.sleep(0.3)
        assert came == [b"%d" % number for number in range(1_000)]
        assert (heard.counts["put"], heard.bytes) == (0, 0)
        del kept, also
