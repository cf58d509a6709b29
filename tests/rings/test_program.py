"""A process of one program shows that it is, and no other can, whatever it has heard."""

from __future__ import annotations

import os

import pytest

from aiorts.rings import proof, proves

SECRET, OURS, THEIRS = b"s" * 16, b"greeting of one", b"greeting of two"


def test_who_knows_the_secret_is_believed() -> None:
    assert proves(SECRET, proof(SECRET, OURS, THEIRS), OURS, THEIRS, process=os.getpid())


@pytest.mark.parametrize(
    ("said", "prover", "verifier"),
    [
        (proof(b"t" * 16, OURS, THEIRS), OURS, THEIRS),
        (proof(SECRET, OURS, THEIRS), THEIRS, OURS),
        (proof(SECRET, OURS, THEIRS), OURS, b"greeting of three"),
        (proof(SECRET, OURS, THEIRS)[:-1], OURS, THEIRS),
        (SECRET, OURS, THEIRS),
        (b"", OURS, THEIRS),
    ],
    ids=["another secret", "turned round", "said to another", "cut off", "the secret itself", "nothing"],
)
def test_another_secret_or_what_was_said_to_another_proves_nothing(said: bytes, prover: bytes, verifier: bytes) -> None:
    assert not proves(SECRET, said, prover, verifier, process=os.getpid())


def test_what_one_process_has_said_proves_nothing_of_another() -> None:
    assert not proves(SECRET, proof(SECRET, OURS, THEIRS), OURS, THEIRS, process=os.getpid() + 1)


def test_without_a_secret_nobody_is_of_this_program() -> None:
    assert not proves(b"", proof(b"", OURS, THEIRS), OURS, THEIRS, process=os.getpid())
