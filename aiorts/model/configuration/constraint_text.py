"""Constraints as text: OpenRTM's grammar, read strictly and written so that reading it gives the same constraint.

    blank                           everything is allowed
    100                             a constant: no other value
    x>=100  x<100  100<=x  100>x    one bound
    100<=x<=200  200>x>=100         two bounds
    (9600, 19200, 115200)           one of these
    x<1, x<10, x>100                an array: one constraint for each element
    {k0: 100<x<200, k1: x>=100}     a hash: one constraint for each key

Additions to OpenRTM's: a value may stand in double quotes, with JSON's escapes; `~"text"` is a regular expression
that the whole value matches; `and` joins constraints that must all hold; an element or key with a blank constraint
takes anything.
"""

from __future__ import annotations

import enum
import json
import math
import re
from typing import Any, Final, NoReturn

from aiorts.errors import DeclarationError
from aiorts.model.configuration.constraints import Constraint

LONGEST: Final = 10_000
"""The most characters of a constraint."""
_TOKEN: Final = re.compile(
    r"""[ \t\r\n]*(?:
        (?P<quoted>~?"(?:[^"\\]|\\.)*")
      | (?P<sign><=|>=|<|>)
      | (?P<mark>[(){},:])
      | (?P<word>[^\s(){},:<>="]+)
    )""",
    re.VERBOSE | re.DOTALL,
)
_NUMBER: Final = re.compile(r"[+-]?(?:inf|(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?)")
_WHOLE: Final = re.compile(r"[+-]?\d+")
_LONGEST_NUMBER: Final = 4000  # Python reads no whole number that is much longer
_BOUND: Final = {">=": "ge", ">": "gt", "<=": "le", "<": "lt"}
_FROM_THE_LEFT: Final = {"<=": "ge", "<": "gt", ">=": "le", ">": "lt"}


def parse_constraint(text: str) -> Constraint:
    """The constraint that `text` describes; values stay texts until a parameter gives them its type.

    Raises:
        DeclarationError: the text is no constraint; shows the place.
    """
    if len(text) > LONGEST:
        raise DeclarationError(f"constraint of {len(text)} characters: at most {LONGEST}")
    return _Reader(text).whole()


class _Reader:
    """A parser that reads from the left, one token ahead."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._at = self._end = 0
        self._kind = self._now = ""
        self._advance()

    def whole(self) -> Constraint:
        """Read the constraint, which ends with the text."""
        if self._kind == "end":
            return Constraint()
        if self._now == "{" and self._kind == "mark":
            constraint = self._hash()
        else:
            parts = [self._all_of()]
            while self._take(","):
                parts.append(self._all_of())
            constraint = parts[0] if len(parts) == 1 else Constraint(elements=tuple(parts))
        if self._kind != "end":
            self._fail("expected the end")
        return constraint

    def _hash(self) -> Constraint:
        self._take("{")
        keys: dict[str, Constraint] = {}
        while not keys or not self._take("}"):
            if keys and not self._take(","):
                self._fail('expected "," or "}"')
            begin = self._at
            key = self._value("a key")
            if key in keys:
                self._fail(f"the key {key!r} stands there twice", begin)
            if not self._take(":"):
                self._fail('expected ":"')
            keys[key] = self._all_of()
        return Constraint(keys=keys)

    def _all_of(self) -> Constraint:
        """Read one constraint, or several joined with `and`."""
        begin = self._at
        found = self._term()
        while self._kind == "word" and self._now == "and":
            self._advance()
            more = self._at
            for name, value in self._term().items():
                if name in found:
                    self._fail("says the same thing twice", more)
                found[name] = value
        try:
            return Constraint(**found)
        except DeclarationError as error:
            self._fail(str(error), begin)

    def _term(self) -> dict[str, Any]:
        if self._kind in ("mark", "end") and self._now in (",", "}", ""):
            return {}
        if self._kind == "quoted" and self._now.startswith("~"):
            return {"pattern": self._quoted(self._now[1:])}
        if self._take("("):
            choices = [self._value("a value")]
            while self._take(","):
                choices.append(self._value("a value"))
            if not self._take(")"):
                self._fail('expected "," or ")"')
            return {"choices": tuple(choices)}
        if self._kind == "word" and self._now == "x":
            self._advance()
            if self._kind != "sign":
                self._fail("expected >=, <=, > or < after x")
            sign = self._sign()
            return {_BOUND[sign]: self._number()}
        begin, quoted = self._at, self._kind == "quoted"
        value = self._value('x, a value, (...) or ~"..."')
        if self._kind != "sign":
            return {"choices": (value,)}
        if quoted or self._number_of(value) is None:
            self._fail("a bound is a number", begin)
        return self._between(self._number_of(value))

    def _between(self, first: float | None) -> dict[str, Any]:
        sign = self._sign()
        if self._kind != "word" or self._now != "x":
            self._fail("expected x")
        self._advance()
        found: dict[str, Any] = {_FROM_THE_LEFT[sign]: first}
        if self._kind == "sign":
            if self._now[0] != sign[0]:
                self._fail("both signs point the same way: 100<=x<=200")
            other = _BOUND[self._sign()]
            found[other] = self._number()
        return found

    # -- tokens ----------------------------------------------------------------------------------------------------

    def _sign(self) -> str:
        sign = self._now
        self._advance()
        return sign

    def _number(self) -> float:
        number = self._number_of(self._now) if self._kind == "word" else None
        if number is None:
            self._fail("expected a number")
        self._advance()
        return number

    def _number_of(self, text: str) -> float | None:
        if _NUMBER.fullmatch(text) is None or len(text) > _LONGEST_NUMBER:
            return None
        number = int(text) if _WHOLE.fullmatch(text) else float(text)
        return None if abs(number) == math.inf and "inf" not in text else number

    def _value(self, expected: str) -> str:
        if self._kind == "quoted" and not self._now.startswith("~"):
            return self._quoted(self._now)
        if self._kind != "word":
            self._fail(f"expected {expected}")
        value = self._now
        self._advance()
        return value

    def _quoted(self, token: str) -> str:
        try:
            value: str = json.loads(token, strict=False)
        except ValueError:
            self._fail("not a text as JSON writes it")
        self._advance()
        return value

    def _take(self, mark: str) -> bool:
        if self._kind != "mark" or self._now != mark:
            return False
        self._advance()
        return True

    def _advance(self) -> None:
        found = _TOKEN.match(self._text, self._end)
        if found is None:
            rest = self._text[self._end :]
            self._at = self._end + len(rest) - len(rest.lstrip(" \t\r\n"))
            if self._at < len(self._text):
                self._fail("cannot be read")
            self._kind, self._now = "end", ""
            return
        self._kind = found.lastgroup or ""
        self._now = found[self._kind]
        self._at, self._end = found.start(self._kind), found.end()

    def _fail(self, what: str, at: int | None = None) -> NoReturn:
        at = self._at if at is None else at
        begin = max(0, at - 40)
        part = self._text[begin : at + 40].replace("\n", " ").replace("\t", " ").replace("\r", " ")
        raise DeclarationError(f"constraint, character {at + 1}: {what}\n  {part}\n  {' ' * (at - begin)}^")


def constraint_text(constraint: Constraint) -> str:
    """The constraint in the grammar of this file; empty when everything is allowed."""
    if constraint.keys is not None:
        return f"{{{', '.join(f'{_written(key)}: {_all_of(part)}' for key, part in constraint.keys.items())}}}"
    if constraint.elements is not None:
        return ", ".join(_all_of(part) for part in constraint.elements)
    return _all_of(constraint)


def _all_of(constraint: Constraint) -> str:
    parts = []
    low, high = constraint.lower, constraint.upper
    if low is not None and high is not None:
        signs = ("<=" if constraint.gt is None else "<", "<=" if constraint.lt is None else "<")
        parts.append(f"{low!r}{signs[0]}x{signs[1]}{high!r}")
    elif low is not None:
        parts.append(f"x{'>=' if constraint.gt is None else '>'}{low!r}")
    elif high is not None:
        parts.append(f"x{'<=' if constraint.lt is None else '<'}{high!r}")
    if constraint.choices is not None:
        choices = [_written(choice) for choice in constraint.choices]
        parts.append(choices[0] if len(choices) == 1 else f"({', '.join(choices)})")
    if constraint.pattern is not None:
        parts.append(f"~{json.dumps(constraint.pattern)}")
    return " and ".join(parts)


def _written(value: object) -> str:
    text = value.name if isinstance(value, enum.Enum) else str(value)
    plain = re.fullmatch(r"[^\s(){},:<>=\"]+", text) and text not in ("x", "and")
    return text if plain else json.dumps(text)
