"""Everything that can be known of a system file without running it: all findings at once, each with its place.

Component files and plugins are imported and components constructed, as in a run; no hook runs, nothing is opened.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from aiorts.errors import AiortsError, StateError, SystemFileError
from aiorts.kernel.extensions.catalogue import Catalogue
from aiorts.model.wanted.entries import ComponentEntry
from aiorts.system.checks.adapting import adapted
from aiorts.system.checks.composed_drafts import compositions, leaf_paths
from aiorts.system.checks.connection_checks import feature_findings, joint_findings
from aiorts.system.checks.draft import Draft, drafts_of
from aiorts.system.checks.findings import Finding, Said, in_order
from aiorts.system.checks.whole import whole_findings
from aiorts.system.expansion.choices import AS_WRITTEN, Choices
from aiorts.system.file.families import parts, with_parts
from aiorts.system.file.parse import Mistake, read, spelled
from aiorts.system.file.survey import Survey, survey
from aiorts.system.file.values import SystemFile
from aiorts.system.text.origins import Origins, Source
from aiorts.system.text.places import Key, Place
from aiorts.system.text.toml import NotToml, read_text

_NUMBERED = re.compile(r"(in|out)put(\d+)")


def check(
    path: str | Path, overrides: Iterable[str] = (), plugins: Iterable[Path] = (), choices: Choices = AS_WRITTEN
) -> tuple[Finding, ...]:
    """The findings about the system file at `path`, in the order of its lines; empty when there are none.

    Args:
        overrides: parameters as "component.param=value", which win over those of the file.
        plugins: folders with plugins, besides those that the file names and the packages that are installed.
        choices: variables, and ports in the place of others.
    """
    where = Path(path)
    try:
        text = read_text(where)
    except SystemFileError as error:
        return (_unread(error, where),)
    return check_text(text, where, overrides, plugins, choices)


def check_text(
    text: str,
    path: Path,
    overrides: Iterable[str] = (),
    plugins: Iterable[Path] = (),
    choices: Choices = AS_WRITTEN,
) -> tuple[Finding, ...]:
    """Check a text, such as the unsaved text of an editor; `path` is the file that the text belongs to."""
    try:
        system, mistakes = read(text, path, overrides, choices)
    except SystemFileError as error:
        return (_unread(error, path),)
    said = [
        Said("error", SystemFileError.code, one.key, one.what, one.of_key, one.where, one.spot(system.origins))
        for one in mistakes
    ]
    said += [
        Said("note", "N-VARIABLE", one.key, one.what, one.of_key, one.where, one.spot(system.origins))
        for one in system.notes
    ]
    found = survey(system, Catalogue(dict.fromkeys((*system.plugin_paths, *plugins))))
    # A component with a mistake in its entry gets no draft: the draft would report the mistake again.
    drafts = drafts_of(found, _marred(mistakes, "components"))
    composed = compositions(system, drafts, _marred(mistakes, "composites"))
    said += composed.said
    said += [of_draft(system, name, one.error) for name, one in drafts.items() if one.error is not None]
    every = {**drafts, **composed.drafts}
    between = adapted(found, every)
    said += between.said
    said += [
        Said("error", fault.error.code, fault.key, str(fault.error), fault.of_key, fault.where)
        for fault in found.faults
    ]
    drafts |= between.drafts
    every |= between.drafts
    said += joint_findings(found, every)
    # Findings about the whole system name the components that run, in the place of their composites.
    found.system = with_parts(leaf_paths(found.system, every))
    said += _of_members(found, drafts)
    said += feature_findings(found)
    # If the ports of a composite are not known, the connections of its members' ports are not known either.
    vague = {part for name, one in composed.drafts.items() if one.error for part in parts(system.composites, name)}
    known = {name: one for name, one in drafts.items() if name not in vague}
    said += whole_findings(found, known, whole=not mistakes and found.services.keys() >= system.services.keys())
    return in_order((_found(system.origins, one) for one in said), system.files)


def _marred(mistakes: Iterable[Mistake], table: str) -> set[str]:
    """The names of those entries of a table that have mistakes."""
    return {str(mistake.key[1]) for mistake in mistakes if mistake.key[:1] == (table,) and mistake.key[1:]}


def _of_members(found: Survey, drafts: dict[str, Draft]) -> Iterable[Said]:
    """The findings about members that their context cannot run."""
    for entry in found.system.contexts.values():
        context = found.contexts.get(entry.name)
        for name in entry.members:
            component = drafts[name].component if name in drafts else None
            if context is None or component is None:
                continue
            try:
                context.runner.check_can_add(component)
            except StateError as error:
                yield Said("error", error.code, ("contexts", entry.name, "members"), str(error))


# -- places ------------------------------------------------------------------------------------------------------------


def of_draft(system: SystemFile, name: str, error: AiortsError) -> Said:
    """The finding about a component that cannot make its ports, at the parameter to blame and the place in its text."""
    entry = system.components[name]
    message = str(error).removeprefix(f"{name}: ")
    what, text, offset = _typed(error)
    for key in _keys(entry, what, message):
        spot = system.origins.inside(key, text, offset) if text else None
        if spot is not None or not text:
            return Said("error", error.code, key, message, spot=spot)
    return Said("error", error.code, ("components", name, "type"), message, where=f"components.{name}")


def _typed(error: AiortsError) -> tuple[str, str, int]:
    """The name, text and wrong character's place of the user's text that an error is about; empty if there is none."""
    known: Any = error
    if isinstance(getattr(known, "place", None), int):
        return str(getattr(known, "what", "")), str(known.text), int(known.place)
    return "", "", 0


def _keys(entry: ComponentEntry, what: str, message: str) -> Iterable[Key]:
    """The keys under which the text may stand, the most likely first."""
    base: Key = ("components", entry.name)
    numbered = _NUMBERED.fullmatch(what)
    named = [param for param in entry.params if param == what or re.search(rf"\b{re.escape(param)}\b", message)]
    if numbered is not None:
        yield (*base, "params", f"{numbered[1]}puts", int(numbered[2]))
    for param in named:
        yield (*base, "params", param)
    for param in entry.params:
        if param not in named and what:
            yield (*base, "params", param)
    if what:
        for number in range(len(entry.options)):
            yield (*base, "options", number)
        yield (*base, "options")


def _found(origins: Origins, said: Said) -> Finding:
    cause, _, remedy = said.text.replace("\n", " ").rpartition("; ")
    if not cause:
        cause, remedy = remedy, ""
    where = said.where or spelled(origins.known(said.key))
    path, place, quote = origins.main.path, Place(0, 0), ""
    if not where.startswith("--") and origins.main.text:
        spot = said.spot or origins.spot(said.key, of_key=said.of_key)
        path, place, quote = spot.source.path, spot.place, spot.quote
    return Finding(
        said.severity,
        said.code,
        path,
        place.line,
        place.column,
        place.width,
        where,
        cause,
        remedy,
        quote,
        said.suggestion,
    )


def _unread(error: SystemFileError, path: Path) -> Finding:
    if not isinstance(error, NotToml):
        return _found(Origins(Source(path, "")), Said("error", error.code, (), str(error).removeprefix(f"{path}: ")))
    quote = error.text.split("\n", error.line)[error.line - 1].rstrip("\r") if error.text else ""
    cause, _, remedy = error.reason.rpartition("; ")
    cause, remedy = (cause, remedy) if cause else (remedy, "")
    return Finding("error", error.code, error.path, error.line, error.column, 1, "", cause, remedy, quote)
