"""One rule: the ports that it connects, how many connectors it may make, and their options."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from fnmatch import translate
from typing import Any, Final

from aiorts.errors import ConfigurationError, WiringError
from aiorts.late import dataclass
from aiorts.model.options import connector_profile
from aiorts.spelling import meant, nearest

USUAL_MAX: Final = 100
"""The most connectors of a rule without `max`."""
LARGEST_MAX: Final = 100_000
_OWN: Final = ("from", "to", "max")
_REFUSED: Final = {
    "name": "each connector of a rule has the name of its ports; take it away",
    "convert": "a rule connects ports of one type; write the pair under [[connections]]",
    "adapt": "a rule connects ports of one type; write the pair under [[connections]]",
    "allow_duplicate": "a rule connects two ports once; take it away",
}
_PART: Final = re.compile(r"(?:[A-Za-z0-9_*?-]|\[!?[A-Za-z0-9_-]+\])+")
_EXAMPLE: Final = 'write COMPONENT.PORT with *, ? or [abc], such as "*.pose"'


@dataclass(frozen=True, slots=True)
class Rule:
    """Each out-port that fits `source` is connected with each in-port of its type that fits `target`."""

    source: str
    target: str
    most: int
    """The most connectors that it makes."""
    options: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Pattern:
    """A pattern for paths of ports: the component and the port each have to fit their part of it."""

    component: re.Pattern[str]
    port: re.Pattern[str]

    def fits(self, component: str, port: str) -> bool:
        """Whether this port of this component fits."""
        return self.component.match(component) is not None and self.port.match(port) is not None


def pattern_of(text: str) -> Pattern:
    """The pattern of a text that was found right."""
    component, _, port = text.partition(".")
    return Pattern(re.compile(translate(component)), re.compile(translate(port)))


def ruled(entries: Iterable[Any]) -> Callable[[str, str, bool], bool]:
    """A function that says whether rules connect a port: of component, port, and whether it is an out-port."""
    rules = [(pattern_of(rule.source), pattern_of(rule.target)) for rule in rules_of(entries)]
    return lambda component, port, out: any(rule[0 if out else 1].fits(component, port) for rule in rules)


def rules_of(entries: Iterable[Any]) -> tuple[Rule, ...]:
    """The rules of the entries of `[[rules]]`.

    Raises:
        ConfigurationError: "rules: [NUMBER].KEY: ...", counted from 1; says what was expected.
    """
    return tuple(_rule(f"rules: [{number}]", entry) for number, entry in enumerate(entries, 1))


def _rule(where: str, entry: Any) -> Rule:
    if not isinstance(entry, Mapping):
        raise ConfigurationError(f"{where}: expected a table with from and to, got {entry!r:.60}")
    source, target = (_pattern(where, word, entry) for word in ("from", "to"))
    most = entry.get("max", USUAL_MAX)
    if isinstance(most, bool) or not isinstance(most, int) or not 1 <= most <= LARGEST_MAX:
        raise ConfigurationError(f"{where}.max: expected a whole number from 1 to {LARGEST_MAX}, got {most!r:.60}")
    options = {word: value for word, value in entry.items() if word not in _OWN}
    for word, value in options.items():
        if word in _REFUSED:
            raise ConfigurationError(f"{where}.{word}: {_REFUSED[word]}")
        if nearest(word, _OWN, cutoff=0.7):
            raise ConfigurationError(f"{where}.{word}: unknown key {str(word)[:60]!r}{meant(word, _OWN)}")
        needs = {"push_rate": 1.0} if str(value).strip().lower() == "periodic" else {}
        _check_options(f"{where}.{word}", {word: value, **needs})
    _check_options(where, options)
    return Rule(source, target, most, options)


def _pattern(where: str, word: str, entry: Mapping[str, Any]) -> str:
    if word not in entry:
        raise ConfigurationError(f"{where}: {word} is missing; {_EXAMPLE}")
    text = entry[word]
    if not isinstance(text, str):
        raise ConfigurationError(f"{where}.{word}: expected text, got {text!r:.60}; {_EXAMPLE}")
    component, dot, port = text.partition(".")
    if len(text) > 200 or not dot or _PART.fullmatch(component) is None or _PART.fullmatch(port) is None:
        raise ConfigurationError(f"{where}.{word}: {text!r:.60} is no pattern for ports; {_EXAMPLE}")
    return text


def _check_options(where: str, options: Mapping[str, Any]) -> None:
    try:
        connector_profile("", options, "", ())
    except WiringError as error:
        raise ConfigurationError(f"{where}: {str(error).removeprefix(': ')}") from None
