"""`[variables]`, and `${name}` in texts.

A text that is only `${name}` becomes the variable's value, with its type; inside a longer text the value is written
out. `$${` is a literal `${`. A `${` inside a value is not expanded again.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, TypeAlias

from aiorts.model.configuration.toml_lines import excess, huge_number
from aiorts.model.values import TRUTH, whole_of
from aiorts.spelling import suggestion
from aiorts.system.expansion.faults import Budget, Fault, weight
from aiorts.system.text.origins import Origin
from aiorts.system.text.places import Key
from aiorts.system.text.toml import LARGEST

ENV: Final = "env"
"""The key of `[variables]` that is no variable: it lists the variables that the environment may set."""
_FIELD: Final = re.compile(r"\$\$\{|\$\{([^{}]*)(\}?)")
_WHOLE: Final = re.compile(r"\$\{([^{}]*)\}")
_CONDITION: Final = re.compile(r"\s*(not\s+)?(\$\{[^{}]*\})\s*")
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_-]{0,99}")
_LONGEST_NUMBER: Final = 300
_KINDS: Final[tuple[tuple[Any, str], ...]] = (
    (bool, "true or false"),
    ((int, float), "a number"),
    (str, "text"),
    (list, "a list"),
)

Given: TypeAlias = Callable[[Any], Any]
"""A value that replaces a default: a function that gets the default and returns the value, or raises a Fault."""


class _Unknown(Fault):
    """There is no variable of this name."""

    def __init__(self, name: str, origin: Origin, known: str, *, of_key: bool) -> None:
        super().__init__(origin, f"unknown variable {name[:80]!r}; {known}", of_key=of_key)
        self.name = name


class Scope:
    """The variables of one file; fills them into its values."""

    def __init__(self, values: Mapping[str, Any], budget: Budget) -> None:
        self.values = values
        self.used: set[str] = set()
        self._budget = budget

    def filled(self, value: Any, origin: Origin, moved: dict[Key, Origin] | None = None) -> Any:
        """The value with the variables in all of its texts; the places of renamed keys are put into `moved`."""
        found = self._filled(value, origin, (), {} if moved is None else moved)
        self._budget.spend(weight(found, origin), origin)
        return found

    def text(self, text: str, origin: Origin, *, of_key: bool = False) -> str:
        """A text with the variables in it written out."""
        if "${" not in text:
            return text
        parts, at, length = [], 0, 0
        for found in _FIELD.finditer(text):
            put = "${" if found[0] == "$${" else self._written(found[1], found[2], origin, of_key=of_key)
            parts += [text[at : found.start()], put]
            at, length = found.end(), length + len(put)
            self._budget.spend(len(put), origin)
        return "".join((*parts, text[at:]))

    def holds(self, given: Any, origin: Origin) -> bool:
        """Whether a condition holds."""
        if isinstance(given, bool):
            return given
        found = _CONDITION.fullmatch(given) if isinstance(given, str) else None
        if found is None:
            raise Fault(origin, f'expected true, false, "${{name}}" or "not ${{name}}", got {given!r:.80}')
        name = found[2][2:-1].strip()
        value = self._value(name, origin)
        if not isinstance(value, bool):
            raise Fault(origin, f"expected a variable that is true or false, and {name} is {value!r:.80}")
        return value is not bool(found[1])

    def _filled(
        self,
        value: Any,
        origin: Origin,
        path: Key,
        moved: dict[Key, Origin],
    ) -> Any:
        if isinstance(value, str):
            if "${" not in value:
                return value
            whole = _WHOLE.fullmatch(value)
            return self._value(whole[1].strip(), origin) if whole is not None else self.text(value, origin)
        if isinstance(value, list):
            return [self._filled(one, origin.below(at), (*path, at), moved) for at, one in enumerate(value)]
        if not isinstance(value, dict):
            return value
        made: dict[str, Any] = {}
        for key, one in value.items():
            known = moved.pop((*path, key), None)
            below = origin.below(key) if known is None else known
            name = self.text(key, below, of_key=True)
            if name in made:
                raise Fault(below, f"there is a key {name[:80]!r} already", of_key=True)
            if name != key or known is not None:
                moved[(*path, name)] = below
            made[name] = self._filled(one, below, (*path, name), moved)
        return made

    def _value(self, name: str, origin: Origin, *, of_key: bool = False) -> Any:
        if name in self.values:
            self.used.add(name)
            return self.values[name]
        known = "there are none; write [variables] with its default; $${ is a ${ that means nothing"
        if self.values:
            known = suggestion(name, self.values)
        raise _Unknown(name, origin, known, of_key=of_key)

    def _written(self, name: str, closed: str, origin: Origin, *, of_key: bool) -> str:
        """The value of a variable as a part of a text."""
        if not closed:
            what = f"${{{name[:40]} has no closing brace; write ${{name}}, or $${{ for a ${{ that means nothing"
            raise Fault(origin, what, of_key=of_key)
        value = self._value(name.strip(), origin, of_key=of_key)
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, list):
            raise Fault(origin, f'{name.strip()} is a list, which stands alone: "${{{name.strip()}}}"', of_key=of_key)
        return str(value)


def declared(
    table: Any, origin: Origin, given: Mapping[str, Given], environ: Mapping[str, str], budget: Budget
) -> Scope:
    """The variables of a file: a given value wins over the environment, and the environment over the default.

    A default may use the variables above it.
    """
    if not isinstance(table, dict):
        raise Fault(origin, f"expected a table of defaults by name, got {table!r:.80}; write [variables]")
    found: dict[str, Any] = {}
    scope = Scope(found, budget)
    listed = _listed(table, origin)
    for name, value in table.items():
        if name == ENV:
            continue
        at = origin.below(name)
        _check_name(name, at, of_key=True)
        try:
            default = scope.filled(value, at)
        except _Unknown as fault:
            if fault.name not in table:
                raise
            what = f"{fault.name} stands below it, and a default uses variables above it; write {fault.name} first"
            raise Fault(fault.origin, what) from None
        _kind(default, at)
        found[name] = _chosen(name, given, listed, environ, default)
    for name, at in listed.items():
        if name not in found:
            if name not in given and name not in environ:
                raise Fault(at, f"{name} is not in the environment; set it, or write a default: {name} = ...")
            found[name] = _chosen(name, given, listed, environ, "")
    return scope


def typed(text: str, fault: Callable[[str], Fault]) -> Given:
    """A value from a command line or the environment: a text that is read as a value of the default's kind."""
    return lambda default: _converted(text, default, fault)


def handed(name: str, value: Any, origin: Origin) -> Given:
    """A value from an including file: it has to be of the default's kind."""

    def agreed(default: Any) -> Any:
        kinds, word = _kind(default, origin)
        if isinstance(value, kinds) and isinstance(value, bool) is isinstance(default, bool):
            return value
        if isinstance(default, str) and isinstance(value, int | float) and not isinstance(value, bool):
            return str(value)  # the number of a repeated part, in a text
        raise Fault(origin, f"expected {word} for {name}, got {value!r:.80}")

    return agreed


def names_of(table: Any) -> Iterable[str]:
    """The variables of a file, as far as its table can be read."""
    if not isinstance(table, dict):
        return ()
    listed = table.get(ENV)
    env = [name for name in listed if isinstance(name, str)] if isinstance(listed, list) else []
    return dict.fromkeys([*(name for name in table if name != ENV), *env])


def _chosen(
    name: str, given: Mapping[str, Given], listed: Mapping[str, Origin], environ: Mapping[str, str], default: Any
) -> Any:
    if name in given:
        return given[name](default)
    if name in listed and name in environ:
        return typed(environ[name], lambda what: Fault(listed[name], f"{name} of the environment: {what}"))(default)
    return default


def _converted(text: str, default: Any, fault: Callable[[str], Fault]) -> Any:
    try:
        text.encode()
    except UnicodeEncodeError:
        raise fault(f"{text!r:.80} is not UTF-8") from None
    try:
        if isinstance(default, bool):
            return TRUTH[text.strip().lower()]
        if isinstance(default, list):
            return _list(text)
        if isinstance(default, float):
            return float(text)
        return _number(text) if isinstance(default, int) else text
    except (KeyError, ValueError, RecursionError):
        word = next(word for kinds, word in _KINDS if isinstance(default, kinds))
        raise fault(f"expected {word}, got {text!r:.80}") from None


def _number(text: str) -> int | float:
    """The number in a text, an int if possible; a float is accepted even if the default is an int."""
    if len(text) > _LONGEST_NUMBER:
        raise ValueError
    try:
        return whole_of(text)
    except ValueError:
        return float(text)


def _list(text: str) -> list[Any]:
    if len(text) > LARGEST or excess(text) is not None:
        raise ValueError
    found = tomllib.loads(f"list = {text}")
    if list(found) != ["list"] or not isinstance(found["list"], list) or huge_number(found) is not None:
        raise ValueError
    return found["list"]


def _kind(value: Any, origin: Origin) -> tuple[Any, str]:
    for kinds, word in _KINDS:
        if isinstance(value, kinds):
            return kinds, word
    raise Fault(origin, f"expected text, a number, true, false or a list, got {value!r:.80}")


def _listed(table: dict[str, Any], origin: Origin) -> dict[str, Origin]:
    """The variables that the environment may set, and the place of each in the list."""
    at, listed = origin.below(ENV), table.get(ENV, [])
    if not isinstance(listed, list):
        what = f'env lists the variables that the environment may set, such as env = ["ROBOT_IP"], got {listed!r:.80}'
        raise Fault(at, f"{what}; a variable is not called env")
    for number, name in enumerate(listed):
        if not isinstance(name, str):
            raise Fault(at.below(number), f"expected the name of a variable, got {name!r:.80}")
        _check_name(name, at.below(number))
    return {name: at.below(number) for number, name in enumerate(listed)}


def _check_name(name: str, origin: Origin, *, of_key: bool = False) -> None:
    if not _NAME.fullmatch(name):
        what = f"variable name {name!r:.80}: allowed are letters, digits, '_' and '-', and no digit comes first"
        raise Fault(origin, what, of_key=of_key)
