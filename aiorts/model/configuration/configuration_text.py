"""The configuration of components as TOML, both ways: written text is read back as the very same values.

    schema = 1
    [components.pid0]
    active = "stiff"
    [components.pid0.sets.default]
    gain = 2.0
    [components.pid0.sets.stiff]
    gain = 5.0
    [components.pid0.parameters.baud_rate]      # a parameter that was added at run time
    type = "int"
    default = 9600

A file replaces the whole configuration of a component that it names: sets that it does not name go, parameters that
its "default" does not name are as declared. None is written `{none = true}`. Pure: opens no file.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import AiortsError, ConfigurationError
from aiorts.late import dataclass
from aiorts.model.configuration.constraint_text import constraint_text, parse_constraint
from aiorts.model.configuration.parameters import ParameterSpec
from aiorts.model.configuration.sets import DEFAULT, ConfigurationState
from aiorts.model.configuration.toml_lines import TOO_LARGE, excess, huge_number, line_of, lines_of
from aiorts.model.configuration.toml_values import basic_string, value_text
from aiorts.model.values import element_types, is_optional, parse_type, type_text, value_type
from aiorts.spelling import suggestion

LARGEST: Final = 4 * 1024 * 1024
"""The most bytes of a configuration file."""
_MOST_FAULTS: Final = 20
_MOST_SETS: Final = 1000
_KEYS: Final = ("active", "sets", "parameters")
_PARAMETER_KEYS: Final = ("type", "default", "unit", "doc", "constraint", "widget", "file")
_NONE: Final = {"none": True}
_NOTHING: Final[Mapping[str, Any]] = MappingProxyType({})


@dataclass(frozen=True, slots=True)
class ComponentEntry:
    """The entry of one component in a file."""

    sets: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    """Values as TOML has them, not yet checked."""
    active: str = DEFAULT
    parameters: Mapping[str, Mapping[str, Any]] = field(default_factory=lambda: _NOTHING)
    """The declarations of parameters that were added at run time."""


class _Faults:
    """The first twenty faults of a file."""

    def __init__(self) -> None:
        self._found: list[str] = []

    def add(self, what: str) -> None:
        """Add a fault; raises ConfigurationError at the twentieth."""
        self._found.append(what)
        if len(self._found) == _MOST_FAULTS:
            self._found.append("and perhaps more")
            self.raise_any()

    def raise_any(self) -> None:
        """Raise ConfigurationError when there is a fault."""
        if self._found:
            raise ConfigurationError("\n".join(self._found))


@dataclass(frozen=True, slots=True)
class Document:
    """A configuration file that was read: the components in it, and the lines of its keys."""

    path: str
    components: Mapping[str, ComponentEntry]
    lines: Mapping[tuple[str, ...], int] = field(default_factory=dict, repr=False, compare=False)

    def state(self, name: str, present: ConfigurationState) -> ConfigurationState:
        """The configuration that the file gives the component `name`, which has `present` now.

        Raises:
            ConfigurationError: names the faults, each with its line.
        """
        entry, faults = self.components[name], _Faults()
        wished = ConfigurationState.of(present.specs)
        for parameter, table in entry.parameters.items():
            place = ("components", name, "parameters", parameter)
            if parameter not in wished.specs:
                try:
                    wished = wished.with_parameter(_declared(parameter, table), name)
                except AiortsError as error:
                    faults.add(self._at(place, str(error)))
        for set_name, values in entry.sets.items():
            place = ("components", name, "sets", set_name)
            try:
                wished = wished if set_name == DEFAULT else wished.added(set_name, {}, name)
            except AiortsError as error:
                faults.add(self._at(place, str(error)))
                continue
            for parameter, value in values.items():
                spec = wished.specs.get(parameter)
                plain = value if spec is None else _decoded(value, spec.type)
                try:
                    wished = wished.changed({parameter: plain}, set_name, name, kept=present.values)
                except AiortsError as error:
                    faults.add(self._at((*place, parameter), str(error)))
        try:
            wished = wished.activated(entry.active, name)
        except AiortsError as error:
            faults.add(self._at(("components", name, "active"), str(error)))
        faults.raise_any()
        return wished

    def plain_sets(self, name: str, present: ConfigurationState) -> dict[str, dict[str, Any]]:
        """The sets of a component of the file, each value as its parameter would hold it, or as it is written."""
        specs = dict(present.specs)
        found: dict[str, dict[str, Any]] = {DEFAULT: {key: spec.default for key, spec in specs.items()}}
        for set_name, values in self.components[name].sets.items():
            found.setdefault(set_name, {}).update(
                {key: _as_held(value, specs.get(key)) for key, value in values.items()}
            )
        return found

    def fail(self, place: Sequence[str], what: str) -> ConfigurationError:
        """The error for a fault at a place."""
        return ConfigurationError(self._at(place, what))

    def _at(self, place: Sequence[str], what: str) -> str:
        return f"{self.path}:{line_of(self.lines, place)}: {'.'.join(place)}: {what}"


# -- reading ---------------------------------------------------------------------------------------------------------


def parse_document(text: str, path: str) -> Document:
    """Parse the text of a document; `path` stands in messages.

    Raises:
        ConfigurationError: names the fault and its line.
    """
    if len(text.encode("utf-8", "surrogatepass")) > LARGEST:
        raise ConfigurationError(f"{path}: larger than {LARGEST} bytes; a configuration file is not")
    text = text.removeprefix("\ufeff")
    if (found := excess(text)) is not None:
        raise ConfigurationError(f"{path}:{text.count(chr(10), 0, found[0]) + 1}: {found[1]}")
    try:
        top = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        end = f"(at line {text.rstrip().count(chr(10)) + 1}, the end of the file)"
        what = str(error).replace("(at end of document)", end) or "nested too deeply"
        raise ConfigurationError(f"{path}: not valid TOML: {what}") from None
    document = Document(path, {}, lines_of(text))
    if (key := huge_number(top)) is not None:
        raise document.fail([str(part) for part in key], TOO_LARGE)
    if top.get("schema") != 1 or isinstance(top.get("schema"), bool):
        raise document.fail(("schema",), f"expected schema = 1 in the first line, got {top.get('schema', 'nothing')!r}")
    _only(document, (), top, ("schema", "components"))
    components = {
        name: _entry(document, name, table) for name, table in _tables(document, (), top, "components").items()
    }
    return Document(path, MappingProxyType(components), document.lines)


def _entry(document: Document, name: str, table: Mapping[str, Any]) -> ComponentEntry:
    place = ("components", name)
    _only(document, place, table, _KEYS)
    active = table.get("active", DEFAULT)
    if not isinstance(active, str):
        raise document.fail((*place, "active"), f"expected the name of a set, got {active!r:.80}")
    sets = _tables(document, place, table, "sets")
    if len(sets) > _MOST_SETS:
        raise document.fail((*place, "sets"), f"{len(sets)} sets; at most {_MOST_SETS}")
    parameters = _tables(document, place, table, "parameters")
    for parameter, declared in parameters.items():
        where = (*place, "parameters", parameter)
        _only(document, where, declared, _PARAMETER_KEYS)
        for key in ("type", "default"):
            if key not in declared:
                raise document.fail(where, f"{key} is missing")
    return ComponentEntry(MappingProxyType(sets), active, MappingProxyType(parameters))


def _tables(
    document: Document, place: tuple[str, ...], table: Mapping[str, Any], key: str
) -> dict[str, Mapping[str, Any]]:
    found = table.get(key, {})
    for name, value in (found if isinstance(found, dict) else {key: found}).items():
        if not isinstance(found, dict) or not isinstance(value, dict):
            where = (*place, key, name) if isinstance(found, dict) else (*place, key)
            raise document.fail(where, f"expected a table, got {value!r:.80}")
    return {name: MappingProxyType(value) for name, value in found.items()}


def _only(document: Document, place: tuple[str, ...], table: Mapping[str, Any], known: Iterable[str]) -> None:
    for key in table:
        if key not in known:
            raise document.fail((*place, key), f"unknown key; {suggestion(key, known)}")


def _declared(name: str, table: Mapping[str, Any]) -> ParameterSpec:
    texts = {key: table.get(key, "") for key in _PARAMETER_KEYS if key != "default"}
    for key, text in texts.items():
        if not isinstance(text, str):
            raise ConfigurationError(f"{key}: expected text, got {text!r:.80}")
    try:
        kind = parse_type(texts["type"])
    except ValueError as error:
        raise ConfigurationError(str(error)) from None
    constraint = parse_constraint(texts["constraint"])
    default = _decoded(table["default"], kind)
    shown = texts["unit"], texts["doc"], constraint, texts["widget"]
    return ParameterSpec(name, default, kind, *shown, file=texts["file"])


def _as_held(value: Any, spec: ParameterSpec | None) -> Any:
    if spec is None:
        return value
    try:
        return spec.check(_decoded(value, spec.type))
    except ConfigurationError:
        return value


def _decoded(value: Any, kind: Any) -> Any:
    """The value with None where TOML has `{none = true}`."""
    if value == _NONE and is_optional(kind):
        return None
    if isinstance(value, list):
        kinds = element_types(kind, len(value))
        return value if kinds is None else [_decoded(item, part) for item, part in zip(value, kinds, strict=True)]
    item_kind = value_type(kind)
    if isinstance(value, dict) and item_kind is not None:
        return {key: _decoded(item, item_kind) for key, item in value.items()}
    return value


# -- writing ---------------------------------------------------------------------------------------------------------


def document_text(states: Mapping[str, ConfigurationState], declared: Mapping[str, Mapping[str, ParameterSpec]]) -> str:
    """The configuration of these components, by name, as text.

    Args:
        declared: the parameters that each component's class declares; the others were added at run time.

    Raises:
        ConfigurationError: a value cannot be written so that it is read back the same; names it.
    """
    lines = ["schema = 1"]
    for name, state in states.items():
        lines += ["", f"[components.{name}]", f"active = {basic_string(state.active)}"]
        for parameter, spec in state.specs.items():
            if parameter not in declared[name] and not _has_enum(spec.type):
                lines += ["", f"[components.{name}.parameters.{parameter}]", *_declaration(name, spec)]
        for set_name, values in state.sets.items():
            lines += ["", f"[components.{name}.sets.{set_name}]"]
            lines += [
                f"{parameter} = {value_text(f'{name}.{parameter}', value)}" for parameter, value in values.items()
            ]
    text = "\n".join(lines) + "\n"
    _check_same(text, states)
    return text


def _check_same(text: str, states: Mapping[str, ConfigurationState]) -> None:
    document = parse_document(text, "the text to be saved")
    for name, state in states.items():
        if repr(document.state(name, state).sets) != repr(state.sets):
            raise ConfigurationError(f"{name}: a value of it cannot be saved so that it would be read back the same")


def _declaration(name: str, spec: ParameterSpec) -> list[str]:
    lines = [f"type = {basic_string(spec.type_text)}", f"default = {value_text(f'{name}.{spec.name}', spec.default)}"]
    for key, text in (
        ("unit", spec.unit),
        ("doc", spec.doc),
        ("constraint", constraint_text(spec.constraint)),
        ("widget", spec.widget),
        ("file", spec.file),
    ):
        if text:
            lines.append(f"{key} = {basic_string(text)}")
    return lines


def _has_enum(kind: Any) -> bool:
    try:
        parse_type(type_text(kind))
    except ValueError:
        return True
    return False
