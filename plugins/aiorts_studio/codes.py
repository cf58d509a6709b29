"""Codes, and the tokens for which clients exchange them. Pure decisions: the clock is passed in.

A code is read by a person or from a file, so it is good once and for a minute. A second use means that one of its two
users has stolen it: the token that it gave ends.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable, Mapping
from enum import Enum
from hmac import compare_digest
from types import MappingProxyType
from typing import Final

from aiorts.errors import DeniedError

CODE_SECONDS: Final = 60.0
"""Seconds for which a code is good."""
GOOD_ONCE: Final = f"it is good once, and for {CODE_SECONDS:.0f} s; `aiorts studio --url` prints another"
"""The message about an address that carries a code."""
TRIES: Final = 10
"""Wrong codes after which the right one is refused, too."""
TOKENS: Final = 16
"""The most good tokens; for one more the token used longest ago ends. A kernel takes as many sessions of a viewer."""
_BYTES: Final = 20
"""The length of a code and of a token: 160 bits."""


class Fault(Enum):
    """The reasons why a code is refused."""

    WRONG = "wrong"
    LATE = "late"
    USED = "used"
    SPENT = "spent"


TEXTS: Final[Mapping[Fault, str]] = MappingProxyType(
    {
        Fault.WRONG: "the code is wrong",
        Fault.LATE: f"the code is older than {CODE_SECONDS:.0f} s",
        Fault.USED: "the code was used before; the token that it gave has ended",
        Fault.SPENT: f"there were {TRIES} wrong codes",
    }
)


class CodeError(DeniedError):
    """A code is refused.

    Attributes:
        fault: the reason.
    """

    def __init__(self, fault: Fault) -> None:
        super().__init__(f"{TEXTS[fault]}; `aiorts studio --url` gives a new one")
        self.fault = fault


class Holder:
    """A client that holds a token.

    Attributes:
        number: the number of the client, for lines that must not show its token.
        used_at: when it asked for something last.
    """

    def __init__(self, number: int, token: str, code: str, now: float) -> None:
        self.number = number
        self.used_at = now
        self._token, self._code = token, code


class Codes:
    """The codes of one server, and the tokens that they gave.

    Args:
        ended: called with the holder of each token that has ended, and the reason; "" where its end was requested.

    Attributes:
        count: tokens that were given.
    """

    def __init__(self, ended: Callable[[Holder, str], None]) -> None:
        self._ended = ended
        self._code = ""
        """The code that is good now; "" for none."""
        self._until = 0.0
        self._tries = 0
        self._holders: list[Holder] = []
        self.count = 0

    @property
    def holders(self) -> tuple[Holder, ...]:
        """The clients whose tokens are good."""
        return tuple(self._holders)

    def issue(self, now: float) -> str:
        """A new code, which takes the place of the one before."""
        self._code, self._until, self._tries = secrets.token_urlsafe(_BYTES), now + CODE_SECONDS, 0
        return self._code

    def exchange(self, code: str, now: float) -> str:
        """The token for a code.

        Raises:
            CodeError: the code is wrong, late or used, or there were too many wrong ones.
        """
        used = [one for one in self._holders if _equal(one._code, code)]
        good = _equal(self._code, code) and self._code != ""
        for one in used:
            self.end(one, TEXTS[Fault.USED])
        if used:
            raise CodeError(self._count_try(Fault.USED))
        if self._tries >= TRIES:
            raise CodeError(Fault.SPENT)
        if not good:
            raise CodeError(self._count_try(Fault.WRONG))
        self._code = ""
        if now > self._until:
            raise CodeError(Fault.LATE)
        if len(self._holders) >= TOKENS:
            self.end(min(self._holders, key=lambda one: one.used_at), f"{TOKENS} clients came after it")
        self.count += 1
        token = secrets.token_urlsafe(_BYTES)
        self._holders.append(Holder(self.count, token, code, now))
        return token

    def holder(self, token: str, now: float) -> Holder | None:
        """The client that holds a token; None for an unknown token."""
        found = [one for one in self._holders if _equal(one._token, token)]
        for one in found:
            one.used_at = now
        return found[0] if found else None

    def end(self, holder: Holder, why: str = "") -> None:
        """End the token of a client. Idempotent."""
        if holder in self._holders:
            self._holders.remove(holder)
            self._ended(holder, why)

    def end_all(self) -> None:
        """End all tokens, and the code."""
        self._code = ""
        for one in self.holders:
            self.end(one)

    def _count_try(self, fault: Fault) -> Fault:
        self._tries += 1
        return fault


def _equal(one: str, other: str) -> bool:
    """Whether two texts are equal; the time that it takes does not show where they differ."""
    return compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))
