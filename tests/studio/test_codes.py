"""Codes are good once and for a minute; tokens are one per client. The clock is a number."""

from __future__ import annotations

import math

import pytest
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from aiorts_studio.codes import CODE_SECONDS, TOKENS, TRIES, CodeError, Codes, Fault, Holder


class Door:
    """Codes, and what was said of the tokens that ended."""

    def __init__(self) -> None:
        self.ended: list[tuple[Holder, str]] = []
        self.codes = Codes(lambda holder, why: self.ended.append((holder, why)))

    def refused(self, code: str, now: float = 0.0) -> Fault:
        with pytest.raises(CodeError, match="aiorts studio --url") as error:
            self.codes.exchange(code, now)
        return error.value.fault


def test_a_code_gives_one_token_to_one_client() -> None:
    door = Door()
    token = door.codes.exchange(door.codes.issue(0.0), CODE_SECONDS)
    holder = door.codes.holder(token, 1.0)
    assert holder is not None
    assert (holder.number, holder.used_at) == (1, 1.0)
    assert door.codes.holder("", 1.0) is None
    assert door.codes.holder(token[:-1], 1.0) is None


def test_a_code_and_a_token_have_128_bits_or_more() -> None:
    door = Door()
    code = door.codes.issue(0.0)
    for text in (code, door.codes.exchange(code, 0.0)):
        assert len(text) * math.log2(64) >= 128


@pytest.mark.parametrize("code", ["", "wrong", "é", "\udc80", "x" * 10_000])
def test_a_wrong_or_missing_code_gives_nothing(code: str) -> None:
    door = Door()
    assert door.refused(code) is Fault.WRONG
    door.codes.issue(0.0)
    assert door.refused(code) is Fault.WRONG


def test_a_late_code_gives_nothing_then_and_later() -> None:
    door = Door()
    code = door.codes.issue(0.0)
    assert door.refused(code, CODE_SECONDS + 0.001) is Fault.LATE
    assert door.refused(code, 0.0) is Fault.WRONG


def test_a_second_use_ends_the_token_and_is_reported() -> None:
    door = Door()
    code = door.codes.issue(0.0)
    token = door.codes.exchange(code, 0.0)
    other = door.codes.exchange(door.codes.issue(0.0), 0.0)
    assert door.refused(code) is Fault.USED
    assert door.codes.holder(token, 0.0) is None
    assert door.codes.holder(other, 0.0) is not None
    assert [(holder.number, "used before" in why) for holder, why in door.ended] == [(1, True)]


def test_the_eleventh_try_is_refused_even_with_the_code() -> None:
    door = Door()
    code = door.codes.issue(0.0)
    for _ in range(TRIES):
        assert door.refused("guess") is Fault.WRONG
    assert door.refused(code) is Fault.SPENT
    assert door.codes.exchange(door.codes.issue(0.0), 0.0)


def test_a_new_code_takes_the_place_of_the_one_before() -> None:
    door = Door()
    before, now = door.codes.issue(0.0), door.codes.issue(0.0)
    assert door.refused(before) is Fault.WRONG
    assert door.codes.exchange(now, 0.0)


def test_of_too_many_clients_the_one_that_asked_longest_ago_ends() -> None:
    door = Door()
    tokens = [door.codes.exchange(door.codes.issue(0.0), 0.0) for _ in range(TOKENS)]
    for at, token in enumerate(tokens[1:], 1):
        assert door.codes.holder(token, float(at))
    door.codes.exchange(door.codes.issue(100.0), 100.0)
    assert [holder.number for holder, _ in door.ended] == [1]


def test_a_token_of_another_server_is_none() -> None:
    first, second = Door(), Door()
    token = first.codes.exchange(first.codes.issue(0.0), 0.0)
    first.codes.end_all()
    assert first.codes.holder(token, 0.0) is None
    assert second.codes.holder(token, 0.0) is None


class Clients(RuleBasedStateMachine):
    """Clients that come, guess, come late and come twice, in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        self.door = Door()
        self.code: str | None = None
        self.issued_at, self.wrong = 0.0, 0
        self.given: dict[str, str] = {}
        """Tokens that are good, by their codes."""
        self.tokens: set[str] = set()
        """All that ever were."""

    @rule(seconds=st.sampled_from([0.0, 0.5, 30.0, 59.5, 60.5]))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule()
    def issue(self) -> None:
        self.code, self.issued_at, self.wrong = self.door.codes.issue(self.now), self.now, 0

    @rule()
    def use(self) -> None:
        if self.code is None:
            return
        if self.wrong >= TRIES:
            assert self.door.refused(self.code, self.now) is Fault.SPENT
        elif self.now - self.issued_at > CODE_SECONDS:
            assert self.door.refused(self.code, self.now) is Fault.LATE
            self.code = None
        else:
            token = self.door.codes.exchange(self.code, self.now)
            assert token not in self.tokens
            self.tokens.add(token)
            self.given[self.code] = token
            self.code = None
            if len(self.given) > TOKENS:  # all were used at the same time: the oldest ends
                del self.given[next(iter(self.given))]

    @rule(code=st.text(max_size=30))
    def guess(self, code: str) -> None:
        self.door.refused(code, self.now)
        self.wrong += 1

    @rule(data=st.data())
    def use_again(self, data: st.DataObject) -> None:
        if self.given:
            code = data.draw(st.sampled_from(sorted(self.given)))
            assert self.door.refused(code, self.now) is Fault.USED
            del self.given[code]
            self.wrong += 1

    @invariant()
    def the_tokens_that_are_good_are_those_of_codes_used_once(self) -> None:
        good = {token for token in self.tokens if self.door.codes.holder(token, self.now) is not None}
        assert good == set(self.given.values())
        assert len(self.door.ended) == len(self.tokens) - len(good)


TestClients = pytest.mark.slow(kept_by="test_a_second_use_ends_the_token_and_is_reported")(Clients.TestCase)
