"""Parses the language of FlexiFilter's map: text in, entries out, without knowledge of ports, types and values.

    map   := entry { "," entry }
    entry := in [":" pin] ">" [ mult [off] ">" ] out [":" pin]

`in` and `out` are port numbers; a pin is a number (0 when missing) or a field path such as `position.x`. `mult` is a
decimal with optional sign and exponent, or a fraction such as `5/9`, `off` the same with its sign required; of two
readings the longer number wins, so `0>1e3>0` is a factor of 1000 and `0>1-5e3>0` is x - 5000. Blanks are allowed around
"," and ">" only. Every other character that does not fit is an error with its place.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from fractions import Fraction

from aiorts.errors import ConfigurationError
from aiorts_flexi.common.place import Scanner, TypedTextError

LONGEST_MAP = 100_000
_LONGEST_NUMBER = 100
_QUOTED = 60

_NUMBER = r"(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
_PORT = re.compile(r"[0-9]{1,6}")
_PIN = re.compile(r"[0-9]{1,9}|[A-Za-z_]\w*(?:\.[A-Za-z_]\w*|\[-?[0-9]{1,9}\])*")
_FRACTION = r"[0-9]+/0*[1-9][0-9]*"
_MULT = re.compile(rf"[+-]?(?:{_FRACTION}|{_NUMBER})")
_OFF = re.compile(rf"[+-](?:{_FRACTION}|{_NUMBER})")
_DECIMAL = re.compile(rf"[+-]?{_NUMBER}")

Pin = int | str
Number = int | float | Fraction
"""A `Fraction` makes the result exact: it is rounded once."""


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the map: `target = source * mult + off`; without `mult` the value is only converted."""

    source: int
    source_pin: Pin
    target: int
    target_pin: Pin
    mult: Number | None = None
    off: Number | None = None
    place: int = field(default=0, compare=False)
    """The place in the text, from 0, where the entry begins."""

    def __str__(self) -> str:
        """The entry as text; parsing it gives an equal entry."""
        factor = "" if self.mult is None else f"{_number_text(self.mult)}{_offset_text(self.off)}>"
        return f"{self.source}:{self.source_pin}>{factor}{self.target}:{self.target_pin}"


def parse_map(text: str) -> tuple[Entry, ...]:
    """The entries of a map, in order. TypedTextError marks the first character that does not fit."""
    if len(text) > LONGEST_MAP:
        reason = f"expected at most {LONGEST_MAP} characters, got {len(text)}"
        raise TypedTextError("map", text, LONGEST_MAP, reason, found=False)
    scanner = _Scanner(text, "map")
    entries = []
    while True:
        scanner.blanks()
        entries.append(_entry(scanner))
        scanner.blanks()
        if scanner.at_end:
            return tuple(entries)
        scanner.symbol(",", "a comma or the end")


def parse_number(text: str, where: str) -> int | float:
    """Parse a decimal number: an int when written as one. ConfigurationError for other texts and infinite floats."""
    if _DECIMAL.fullmatch(text) is None or len(text) > _LONGEST_NUMBER:
        raise ConfigurationError(f"{where}: expected a decimal number such as -1.5e3, got {text[:_QUOTED]!r}")
    if text.lstrip("+-").isdecimal():
        return int(text)
    number = float(text)
    if math.isinf(number):
        raise ConfigurationError(f"{where}: {text[:_QUOTED]} is too large for a number of 64 bits")
    if number == 0.0 and re.search("[1-9]", re.split("[eE]", text)[0]):
        raise ConfigurationError(f"{where}: {text[:_QUOTED]} is too small for a number of 64 bits, which makes it 0")
    return number


class _Scanner(Scanner):
    """The text of a map."""

    @property
    def at_end(self) -> bool:
        return self.place == len(self.text)

    def expect(self, pattern: re.Pattern[str], expected: str) -> str:
        found = self.take(pattern)
        if found is None:
            raise self.error(f"expected {expected}")
        return found

    def symbol(self, symbol: str, expected: str) -> None:
        if not self.has(symbol):
            raise self.error(f"expected {expected}")
        self.place += len(symbol)

    def has(self, symbol: str) -> bool:
        return self.text.startswith(symbol, self.place)


def _entry(scanner: _Scanner) -> Entry:
    start = scanner.place
    source = int(scanner.expect(_PORT, "the number of an in-port"))
    source_pin = _pin(scanner)
    scanner.blanks()
    scanner.symbol(">", "'>'" if isinstance(source_pin, str) else "':' and a pin, or '>'")
    scanner.blanks()
    mult, off = _factor(scanner)
    target = int(scanner.expect(_PORT, "the number of an out-port"))
    return Entry(source, source_pin, target, _pin(scanner), mult, off, start)


def _pin(scanner: _Scanner) -> Pin:
    if not scanner.has(":"):
        return 0
    scanner.symbol(":", "':'")
    pin = scanner.expect(_PIN, "a pin: a number, or a field such as position.x")
    return int(pin) if pin[0].isdecimal() else pin


def _factor(scanner: _Scanner) -> tuple[Number | None, Number | None]:
    """Multiplier and offset; None for both when the number that was read is the out-port."""
    place = scanner.place
    found = scanner.take(_MULT)
    if found is None:
        return None, None
    with_offset = scanner.take(_OFF)
    scanner.blanks()
    if not scanner.has(">"):
        if with_offset is not None or not found.isdecimal():
            raise scanner.error("expected '>' after the factor")
        scanner.place = place
        return None, None
    where = f"map, character {place + 1}"
    mult = _number(found, where)
    off = None if with_offset is None else _number(with_offset, where)
    scanner.symbol(">", "'>'")
    scanner.blanks()
    return mult, off


def _number(text: str, where: str) -> Number:
    if "/" not in text:
        return parse_number(text, where)
    if len(text) > _LONGEST_NUMBER:
        raise ConfigurationError(f"{where}: expected a fraction such as 5/9, got {text[:_QUOTED]!r}")
    return Fraction(text)


def _number_text(number: Number) -> str:
    return f"{number.numerator}/{number.denominator}" if isinstance(number, Fraction) else repr(number)


def _offset_text(off: Number | None) -> str:
    if off is None:
        return ""
    text = _number_text(off)
    return text if text.startswith("-") else f"+{text}"
