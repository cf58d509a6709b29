"""Reads the tables of a system file beyond the plain ones: sets, supervision, start, composites, the watch of the loop.

Pure, as `parse`: the values are made and checked here wherever no component has to be loaded for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from fnmatch import fnmatchcase
from functools import partial
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.model.composition import ErrorPolicy, exports, groups_of
from aiorts.model.names import check_name
from aiorts.model.sequence import StartRule, in_order
from aiorts.model.sets import DEFAULT
from aiorts.model.supervision import Supervision
from aiorts.system.places import Key
from aiorts.system.reading import NOTHING, Reading
from aiorts.system.values import ComponentEntry, CompositeEntry, WatchEntry

__all__ = ("COMPOSITE_KEYS", "ORDERS", "POLICIES", "START_KEYS", "SUPERVISION_KEYS", "EntryReader")

COMPOSITE_KEYS: Final = ("members", "exported", "order", "groups", "errors", "own_schedule")
SUPERVISION_KEYS: Final = tuple(field.name for field in fields(Supervision))
START_KEYS: Final = tuple(field.name for field in fields(StartRule) if field.name != "component")
ORDERS: Final = ("stated", "dataflow")
POLICIES: Final = ("warn", "exit")
_LOOSE: Final[Mapping[str, Mapping[str, Any]]] = {"backoff": {"backoff_max": 1e300}, "backoff_max": {"backoff": 1e-300}}


class EntryReader(Reading):
    """The part of the reader that reads them."""

    # -- of a component ----------------------------------------------------------------------------------------------

    def _sets(self, key: Key, table: dict[str, Any]) -> Mapping[str, Mapping[str, Any]]:
        good: dict[str, Mapping[str, Any]] = {}
        for name, values in self._get(key, table, "sets", dict, {}).items():
            where: Key = (*key, "sets", name)
            try:
                check_name(name, "configuration set")
            except AiortsError as error:
                self._say(where, str(error), of_key=True)
                continue
            if name == DEFAULT:
                self._say(where, f"the set {DEFAULT!r} is what params says; write it under params", of_key=True)
            elif name.startswith("_"):
                self._say(where, "names that begin with '_' are not for configuration sets", of_key=True)
            elif isinstance(values, dict):
                good[name] = MappingProxyType(dict(values))
            else:
                self._say(where, f"expected a table of parameters, got {values!r:.60}")
        return MappingProxyType(good)

    def _supervision(self, key: Key, table: dict[str, Any]) -> Supervision | None:
        if "supervision" not in table:
            return None
        key = (*key, "supervision")
        given = self._get(key[:-1], table, "supervision", dict, {})
        if "restart" not in given and "deadline" not in given and "deadlines" not in given:
            wrong = self._only(key, given, SUPERVISION_KEYS)
            if not wrong:
                what = 'says nothing that is done; write restart = "reset" or "restart", or a deadline'
                self._say(key, what, of_key=True)
            return None
        made: Supervision | None = self._made(key, given, SUPERVISION_KEYS, Supervision)
        return made

    def _start(self, key: Key, table: dict[str, Any]) -> StartRule | None:
        if "start" not in table:
            return None
        given = self._get(key, table, "start", dict, {})
        make = partial(StartRule, str(key[-1]))
        made: StartRule | None = self._made((*key, "start"), given, START_KEYS, make)
        return made

    def _made(self, key: Key, given: dict[str, Any], known: tuple[str, ...], make: Any) -> Any:
        """What `make` makes of the values; each is tried alone first, so that each that is wrong is marked."""
        before = len(self.mistakes)
        self._only(key, given, known)
        for word, value in given.items():
            if word not in known:
                continue
            if word == "deadlines" and not isinstance(value, dict):
                self._say((*key, word), f"expected a table of seconds by hook, got {value!r:.80}")
                continue
            if word == "after" and isinstance(value, list):
                for number, text in enumerate(value):
                    self._try((*key, word, number), lambda text=text: make(after=(text,)))
                continue
            # The two limits of a delay are compared with each other below.
            loose = (
                {"backoff_max": 1e300} if word == "backoff" else {"backoff": 1e-300} if word == "backoff_max" else {}
            )
            self._try((*key, word), lambda word=word, value=value, loose=loose: make(**{word: value, **loose}))
        if len(self.mistakes) > before:
            return None
        return self._try(key, lambda: make(**given), of_key=True)

    def _try(self, key: Key, make: Any, *, of_key: bool = False) -> Any:
        try:
            return make()
        except AiortsError as error:
            word = next((part for part in reversed(key) if isinstance(part, str)), "")
            text = str(error).removeprefix(f"{key[1]}: ").removeprefix(f"{word} = ")
            self._say(key, text, of_key=of_key)
            return None

    # -- composites --------------------------------------------------------------------------------------------------

    def _composites(
        self, top: dict[str, Any], components: Mapping[str, ComponentEntry]
    ) -> Mapping[str, CompositeEntry]:
        tables = self._tables(top, "composites", "component")
        good = {}
        for name, table in tables.items():
            if name in components:
                self._say(("composites", name), f"there is a component {name!r}; choose another name", of_key=True)
                continue
            good[name] = self._composite(name, table, {**components, **tables})
        self._families(good)
        return MappingProxyType(good)

    def _composite(self, name: str, table: dict[str, Any], known: Mapping[str, Any]) -> CompositeEntry:
        key: Key = ("composites", name)
        self._only(key, table, COMPOSITE_KEYS)
        members = self._members(key, self._get(key, table, "members", list, missing=[]), known)
        options: dict[str, Any] = {
            word: value
            for word, allowed in (("order", ORDERS), ("errors", tuple(ErrorPolicy)))
            if (value := self._word(key, table, word, allowed)) is not None
        }
        if self._get(key, table, "own_schedule", bool, default=False):
            options["own_schedule"] = True
        if "groups" in table:
            groups = self._try((*key, "groups"), lambda: groups_of(_texts(table["groups"]), members, name))
            if groups:
                options["groups"] = groups
        given = table.get("exported", [])
        if exported := self._exported((*key, "exported"), given, members):
            options["exported"] = exported
        return CompositeEntry(name, members, MappingProxyType(options), isinstance(given, dict))

    def _members(self, key: Key, given: Any, known: Mapping[str, Any]) -> tuple[str, ...]:
        """Names of components and composites, each once."""
        members = self._texts((*key, "members"), given)
        for number, member in enumerate(members):
            where: Key = (*key, "members", number)
            if member not in known:
                self._unknown(where, "component", member, known)
            elif member in members[:number]:
                self._say(where, f"{member!r} stands there twice")
        return tuple(dict.fromkeys(member for member in members if member in known))

    def _word(self, key: Key, table: dict[str, Any], word: str, allowed: Iterable[str]) -> str | None:
        value = self._get(key, table, word, str, NOTHING if word in table else None)
        if value is None or value is NOTHING:
            return None
        if value not in allowed:
            self._unknown((*key, word), word, value, [str(one) for one in allowed])
            return None
        return str(value)

    def _exported(self, key: Key, given: Any, members: tuple[str, ...]) -> dict[str, str]:
        """The rules as patterns and names."""
        if isinstance(given, str):
            given = [part.strip() for part in given.split(",") if part.strip()]
        if not isinstance(given, list | dict):
            what = 'a list such as ["arm.force"] or a table of names by pattern'
            self._say(key, f"expected {what}, got {given!r:.80}")
            return {}
        pairs = given.items() if isinstance(given, dict) else [(pattern, "{port}") for pattern in given]
        good = {}
        for number, (pattern, shown) in enumerate(pairs):
            where: Key = (*key, pattern if isinstance(given, dict) else number)
            rules = self._try(where, lambda pattern=pattern, shown=shown: self._rule(pattern, shown, key))
            if rules is None:
                continue
            if not any(fnmatchcase(member, rules[0].component) for member in members):
                of_key = isinstance(given, dict)
                self._unknown(where, "member", rules[0].component, members, of_key=of_key)
            else:
                good[pattern] = shown
        return good

    def _rule(self, pattern: Any, shown: Any, key: Key) -> Any:
        if not isinstance(pattern, str):
            raise ConfigurationError(f'expected text such as "arm.force", got {pattern!r:.80}; write COMPONENT.PORT')
        return exports({pattern: shown}, str(key[1]))

    def _families(self, composites: dict[str, CompositeEntry]) -> None:
        """Refuse a member of two composites, and one that would be a member of itself."""
        owners: dict[str, str] = {}
        for entry in composites.values():
            for number, member in enumerate(entry.members):
                owner = owners.setdefault(member, entry.name)
                if owner != entry.name:
                    what = f"{member!r} is a member of {owner} already; take it away from one of them"
                    self._say(("composites", entry.name, "members", number), what)
        for name in composites:
            seen, here = [name], name
            while (here := owners.get(here, "")) not in ("", *seen):
                seen.append(here)
            if here == name:
                way = " -> ".join([name, *reversed(seen)])
                self._say(("composites", name, "members"), f"would be a member of itself: {way}")
                for one in seen:
                    owners.pop(one, None)
                    composites[one] = replace(composites[one], members=())  # who follows the way finds an end

    # -- the order of starting ---------------------------------------------------------------------------------------

    def _start_order(
        self, components: Mapping[str, ComponentEntry], known: Mapping[str, Any], tables: Mapping[str, Any]
    ) -> None:
        """Refuse conditions about nobody, and rules that wait for each other."""
        rules = [entry.start for entry in components.values() if entry.start is not None]
        for rule in rules:
            for number, condition in enumerate(rule.conditions):
                if condition.component not in known:
                    key: Key = ("components", rule.component, "start", "after")
                    if isinstance(tables[rule.component]["start"]["after"], list):
                        key = (*key, number)
                    self._unknown(key, "component", condition.component, known)
        try:
            in_order(rules)
        except AiortsError as error:
            first = str(error).rpartition(": ")[2].partition(" ")[0]
            self._say(("components", first, "start", "after"), str(error))

    # -- the loop ----------------------------------------------------------------------------------------------------

    def _watch(self, top: dict[str, Any]) -> WatchEntry:
        key: Key = ("watch_loop",)
        table = self._get((), top, "watch_loop", dict, {})
        self._only(key, table, ("limit", "policy"))
        limit = table.get("limit", WatchEntry().limit)
        if isinstance(limit, bool) or not isinstance(limit, int | float) or not 0 < limit < float("inf"):
            self._say((*key, "limit"), f"expected seconds above 0, such as 5.0, got {limit!r:.80}")
            limit = WatchEntry().limit
        policy = self._word(key, table, "policy", POLICIES)
        return WatchEntry(float(limit), policy or WatchEntry().policy)


def _texts(groups: Any) -> Any:
    """Groups as they may stand in a file: one text, or lists of names."""
    ok = isinstance(groups, str) or (
        isinstance(groups, list)
        and all(isinstance(group, list) and all(isinstance(name, str) for name in group) for group in groups)
    )
    return groups if ok else _refuse(groups)


def _refuse(groups: Any) -> Any:
    raise ConfigurationError(f'expected a text such as "a,b|c,d", or lists of names, got {groups!r:.80}')
