"""The firewall of the guide: who opens many connections and closes them at once keeps nobody out for long."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from aiorts.guide import blocks, page
from network.attack_parts import Target, beside
from network.certificate_parts import folder
from network.host_parts import own_network
from network.test_floods import joins, listening

PORT = "7447"
"""That of the rules."""
COUNT = "800"
ATTACKER = "127.0.0.9"
"""The address that attacks; that of all others is 127.0.0.1."""
WAITS = 6.0
"""Seconds: the wait of two that the page says, and the kernel's own time on a busy machine."""
IDLING = [sys.executable, str(Path(__file__).with_name("idling_program.py"))]


@pytest.fixture(scope="module")
def rules() -> str:
    """The firewall, as the page has it."""
    found = page("secure-network")
    assert found is not None
    (text,) = [one.text for one in blocks(found.path.read_text(encoding="utf-8")) if one.title == "firewall.nft"]
    return text


@pytest.mark.fault("E12")
def test_a_newcomer_joins_soon_after_one_address_has_closed_800_connections_at_once(tmp_path: Path, rules: str) -> None:
    folder(tmp_path, reader="component", writer="component")
    with own_network(rules), listening(tmp_path, f"127.0.0.1:{PORT}") as address:
        attack = subprocess.Popen(
            [*IDLING, address, COUNT, ATTACKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        try:
            assert attack.stdout is not None
            assert [attack.stdout.readline(), attack.stdout.readline()] == ["16 open\n", "16 closed\n"]
            assert asyncio.run(joins(address, tmp_path)) < WAITS, "91 s without the rules"
        finally:
            attack.kill()
            attack.communicate(timeout=10.0)


@pytest.mark.fault("E12")
def test_800_idle_connections_closed_at_once_do_no_harm_to_a_system(tmp_path: Path, rules: str) -> None:
    def attack(target: Target) -> Sequence[str]:
        return [*IDLING, target.address, COUNT, ATTACKER]

    with own_network(rules.replace(PORT, "1024-65535")):  # the system takes a port that is free
        found = beside(tmp_path, attack, seconds=3.0)
    print(found)
    assert found.ratio >= 0.98, found
    assert found.lost == 0, found
    assert found.worst_answer < 2.0, found
    assert found.grown < 5 << 20, found
