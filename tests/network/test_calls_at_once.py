"""A viewer's single calls, two thousand at once, take nothing of a kernel that others need."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

from campaign import CAMPAIGN
from network.attack_parts import Target, beside

COUNT = 2_000
CALLS = Path(__file__).with_name("calling_program.py")


@pytest.mark.slow(kept_by="control/test_clients.py::test_a_client_has_its_connections_and_those_who_look_leave_some")
@pytest.mark.parametrize("operation", ["names", "profile", "session"])
def test_two_thousand_calls_or_sessions_of_a_viewer_hold_nothing_up(operation: str, tmp_path: Path) -> None:
    def attack(target: Target) -> Sequence[str]:
        return [sys.executable, str(CALLS), target.address, str(target.certificates), "anna", str(COUNT), operation]

    found = beside(tmp_path, attack, seconds=8.0 if CAMPAIGN else 3.0, names={"anna": "viewer"})
    print(found)
    for one in found.rounds:
        if one.attacked:
            said = {word: int(count) for word, _, count in (part.partition("=") for part in one.said.split())}
            assert said["other"] == 0, found
            assert said["answered"] + said["refused"] >= COUNT, found
    assert found.ratio >= 0.98, found
    assert found.lost == 0, found
    assert found.worst_answer < 2.0, found
    assert found.grown < 5 << 20, found
