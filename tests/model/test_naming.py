"""The lowest free number behind a stem, found without counting through those in use."""

from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from aiorts.model.naming import Numbering
from campaign import cases

STEMS = ("n", "n1", "event")


def lowest(stem: str, first: int, used: set[str]) -> str:
    number = first
    while f"{stem}{number}" in used:
        number += 1
    return f"{stem}{number}"


class Names(RuleBasedStateMachine):
    """Names are taken and given up in any order, also by who never asked for a number."""

    def __init__(self) -> None:
        super().__init__()
        self.used: set[str] = set()
        self.numbering = Numbering(self.used.__contains__)

    @rule(stem=st.sampled_from(STEMS))
    def take_lowest(self, stem: str) -> None:
        self.used.add(self.numbering.lowest(stem))

    @rule(stem=st.sampled_from(STEMS), number=st.integers(0, 15))
    def take(self, stem: str, number: int) -> None:
        self.used.add(f"{stem}{number}")

    @rule(data=st.data())
    def give_up(self, data: st.DataObject) -> None:
        if self.used:
            name = data.draw(st.sampled_from(sorted(self.used)))
            self.used.discard(name)
            self.numbering.free(name)

    @rule(name=st.sampled_from(["n", "n01", "other7", "event3", "n15"]))
    def give_up_what_was_another_s(self, name: str) -> None:
        if name not in self.used:
            self.numbering.free(name)

    @invariant()
    def it_is_the_lowest(self) -> None:
        for stem in STEMS:
            assert self.numbering.lowest(stem) == lowest(stem, 0, self.used)


TestNames = Names.TestCase
TestNames.pytestmark = [pytest.mark.slow(kept_by="test_first_number_may_be_another")]
TestNames.settings = settings(max_examples=max(30, cases(2000)), stateful_step_count=60)


def test_first_number_may_be_another() -> None:
    used = {"a-b", "a-b-2", "a-b-3"}
    numbering = Numbering(used.__contains__)
    assert numbering.lowest("a-b-", 2) == "a-b-4"
    used.discard("a-b-2")
    numbering.free("a-b-2")
    assert numbering.lowest("a-b-", 2) == "a-b-2"


@pytest.mark.fault("G07")
@pytest.mark.parametrize("order", [1, -1, 7])
def test_a_name_costs_the_same_however_many_there_are(order: int) -> None:
    asked = 0
    used: set[str] = set()

    def taken(name: str) -> bool:
        nonlocal asked
        asked += 1
        return name in used

    numbering = Numbering(taken)
    count = 5000
    for _ in range(count):
        used.add(numbering.lowest("event"))
    names = sorted(used, key=lambda name: int(name[5:]) * order % count)
    for name in names:
        used.discard(name)
        numbering.free(name)
    assert asked < 4 * count
    assert numbering._stems == {}, "what is known of a stem is forgotten with its last name"
