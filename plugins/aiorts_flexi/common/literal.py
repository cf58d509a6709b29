"""Parses values that a user typed, literals of JSON or of Python: nothing is ever run, and nothing can grow large.

    value  := number | text | bytes | list | mapping | truth | nothing
    number := [+-] ( 12 | 0x1f | 0o17 | 0b11 | 1.5e3 | NaN | nan | Infinity | inf )
    text   := "..." or '...' with the escapes of JSON and \\xNN \\UNNNNNNNN \\' \\a \\v \\0
    bytes := b"..."
    list   := [ value, ... ] or ( value, ... )          mapping := { text: value, ... }
    truth  := true | false | True | False               nothing := null | None

One pass, a fixed depth, no operators and no names. A text that is longer than `LONGEST` characters, nests deeper than
`DEEPEST` or writes a number that no 64 bits hold is refused with the place.
"""

from __future__ import annotations

import math
import re
from typing import Any, Final

from aiorts_flexi.common.place import Scanner, TypedTextError

LONGEST: Final = 20_000
DEEPEST: Final = 32
_LONGEST_NUMBER: Final = 400
_WHOLE: Final = re.compile(r"[+-]?(?:0[xX][0-9a-fA-F]+|0[oO][0-7]+|0[bB][01]+|[0-9]+)(?![\w.])", re.ASCII)
_DECIMAL: Final = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?(?![\w.])", re.ASCII)
_WORD: Final = re.compile(r"[+-]?[A-Za-z_]\w*")
_PLAIN: Final = re.compile(r"[^\\\"'\x00-\x1f]+")
_WORDS: Final[dict[str, Any]] = {
    **dict.fromkeys(("true", "True"), True),
    **dict.fromkeys(("false", "False"), False),
    **dict.fromkeys(("null", "None"), None),
    **dict.fromkeys(("NaN", "nan"), math.nan),
    **dict.fromkeys(("Infinity", "inf", "+Infinity", "+inf"), math.inf),
    **dict.fromkeys(("-Infinity", "-inf"), -math.inf),
}
_ESCAPES: Final = {
    "n": "\n",
    "t": "\t",
    "r": "\r",
    "b": "\b",
    "f": "\f",
    "a": "\a",
    "v": "\v",
    "0": "\0",
    **{character: character for character in "\\/\"'"},
}
_CODES: Final = {"x": 2, "u": 4, "U": 8}
_BRACKETS: Final = {"[": "]", "(": ")"}


def parse_literal(text: str, what: str = "constant") -> Any:
    """The value of a literal: None, bool, int, float, str, bytes, list (of a tuple too) or dict with text as keys.

    Raises:
        TypedTextError: the text is no literal; the error names the character of `what` that does not fit.
    """
    if len(text) > LONGEST:
        raise TypedTextError(
            what, text, LONGEST, f"expected at most {LONGEST} characters, got {len(text)}", found=False
        )
    reader = _Reader(text, what)
    value = reader.value(0)
    reader.blanks()
    if reader.place != len(text):
        raise reader.error("expected the end: a literal stands alone, without operators, names or calls")
    return value


class _Reader(Scanner):
    """Reads values of a literal, from the present place in the text."""

    @property
    def next(self) -> str:
        return self.text[self.place : self.place + 1]

    def value(self, depth: int) -> Any:
        self.blanks()
        character = self.next
        if character in ('"', "'") and character:
            return self.quoted()
        if character in ("[", "(", "{") and character:
            if depth >= DEEPEST:
                raise self.error(f"expected at most {DEEPEST} brackets inside each other")
            return self.mapping(depth) if character == "{" else self.list(depth)
        if character == "b" and self.text[self.place + 1 : self.place + 2] in ('"', "'"):
            return self.byte_string()
        return self.word() if character.isalpha() or character == "_" else self.number()

    def word(self) -> Any:
        place, found = self.place, self.take(_WORD)
        if found is None or found not in _WORDS:
            raise self.error('expected a literal such as 1.5, true, [1, 2], "text"; names are none', place)
        return _WORDS[found]

    def number(self) -> Any:
        place = self.place
        if (found := self.take(_WHOLE)) is not None:
            if len(found) <= _LONGEST_NUMBER:
                unsigned = found.lstrip("+-")
                base = 0 if unsigned[:2].lower() in ("0x", "0o", "0b") else 10
                return int(found, base)
        elif (found := self.take(_DECIMAL)) is not None:
            number = float(found) if len(found) <= _LONGEST_NUMBER else math.inf
            if math.isfinite(number):
                return number
        elif (found := self.take(_WORD)) is not None and found in _WORDS:
            return _WORDS[found]
        if found is not None:
            self.place = place
        raise self.error("expected a number of 64 bits" if found and found[-1:].isdigit() else "expected a literal")

    # -- text ------------------------------------------------------------------------------------------------------

    def quoted(self) -> str:
        start, quote = self.place, self.next
        self.place += 1
        parts: list[str] = []
        while (character := self.next) != quote:
            if (plain := self.take(_PLAIN)) is not None:
                parts.append(plain)
            elif character == "\\":
                parts.append(self.escape())
            elif character in ('"', "'") and character:
                parts.append(character)
                self.place += 1
            elif not character:
                raise self.error(f"expected {quote}, which ends the text", start)
            else:
                raise self.error("expected an escape such as \\n in place of a control character")
        self.place += 1
        joined = "".join(parts)
        try:
            # A pair of surrogates is how JSON writes a character beyond 0xffff; half of one is no text.
            return joined.encode("utf-16-le", "surrogatepass").decode("utf-16-le")
        except UnicodeDecodeError:
            raise self.error("expected text, half of a surrogate pair is none", start) from None

    def escape(self) -> str:
        start, kind = self.place, self.text[self.place + 1 : self.place + 2]
        length = _CODES.get(kind)
        if length is None:
            if kind not in _ESCAPES:
                raise self.error('expected an escape such as \\n, \\" or \\u00e9')
            self.place += 2
            return _ESCAPES[kind]
        digits = self.text[start + 2 : start + 2 + length]
        if re.fullmatch(f"[0-9a-fA-F]{{{length}}}", digits) is None or int(digits, 16) > 0x10FFFF:
            raise self.error(f"expected \\{kind} and {length} hexadecimal digits of a character")
        self.place += 2 + length
        return chr(int(digits, 16))

    def byte_string(self) -> bytes:
        start = self.place
        self.place += 1
        text = self.quoted()
        if any(ord(character) > 0xFF for character in text):
            raise self.error("expected bytes, \\x00 to \\xff", start)
        return text.encode("latin-1")

    # -- lists and mappings ----------------------------------------------------------------------------------------

    def list(self, depth: int) -> list[Any]:
        closing = _BRACKETS[self.next]
        round_ = closing == ")"
        start = self.place
        self.place += 1
        values: list[Any] = []
        commas = 0
        while not self.at(closing):
            values.append(self.value(depth + 1))
            commas += self.comma(closing, start)
        self.place += 1
        if round_ and len(values) == 1 and not commas:
            raise self.error("expected a comma after the only item of a tuple, as in (1,)", self.place - 1)
        return values

    def mapping(self, depth: int) -> dict[str, Any]:
        start = self.place
        self.place += 1
        found: dict[str, Any] = {}
        while not self.at("}"):
            place = self.place
            if self.next not in ('"', "'") or not self.next:
                raise self.error("expected a field's name in quotes")
            key = self.quoted()
            if key in found:
                raise self.error(f"expected each name once, {key!r} stands twice", place)
            self.blanks()
            if self.next != ":":
                raise self.error("expected ':' after the name")
            self.place += 1
            found[key] = self.value(depth + 1)
            self.comma("}", start)
        self.place += 1
        return found

    def at(self, closing: str) -> bool:
        self.blanks()
        return self.next == closing

    def comma(self, closing: str, start: int) -> int:
        """Step over a comma and return 1; return 0 where `closing` comes first."""
        self.blanks()
        if self.next == ",":
            self.place += 1
            return 1
        if self.next == closing:
            return 0
        if not self.next:
            raise self.error(f"expected {closing}, which ends the bracket", start)
        raise self.error(f"expected ',' or {closing!r}")
