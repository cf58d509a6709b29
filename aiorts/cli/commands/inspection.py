"""`aiorts inspect NAME`: describes a component or a record type without running it: no hook is called.

A component whose parameters decide its ports (its class has a method `make_ports`, which only makes ports) is
constructed with the given options, outside any kernel; for any other class, only the declarations are read.
"""

from __future__ import annotations

import inspect as source_of
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any, Final

import click

from aiorts import Component, Declaration, MultiModeComponent, declaration_of, exits
from aiorts.cli.commands.live.look.describing import text_of
from aiorts.cli.commands.live.look.reading import report_of, tell_of
from aiorts.cli.commands.record_types import profile_of_type
from aiorts.cli.console.completion import subjects, type_names
from aiorts.cli.console.output import plain, say_either, table
from aiorts.cli.console.subjects import Subject, find_subject
from aiorts.errors import UnknownTypeError
from aiorts.kernel.extensions.type_modules import import_types
from aiorts.late import dataclass
from aiorts.model.profile import MethodProfile, ParameterProfile
from aiorts.system import construct

_WIDEST: Final = 48
_DIRECTIONS: Final = {"in": "in ", "out": "out", "service": "srv"}


@click.command(
    short_help="Show a component or a type without running it.",
    context_settings={"ignore_unknown_options": True, "help_option_names": ["--help"]},
)
@click.argument("name", shell_complete=subjects)
@click.argument("options", nargs=-1, type=click.UNPROCESSED, metavar="[ITS OPTIONS]...", shell_complete=type_names)
@click.option("--type-mod", "modules", multiple=True, metavar="MODULE", help="Import MODULE, which defines types.")
@click.option("--json", "as_json", is_flag=True, help="The profile as one JSON document.")
def inspect(name: str, options: tuple[str, ...], modules: tuple[str, ...], as_json: bool) -> int:
    """Show what NAME is: ports, parameters, hooks, documentation, package and source.

    NAME is an installed component (FlexiFilter), FILE.py:Class, package.module:Class, or a record type (TimedPose2D);
    else a component or port that runs, shown as aiorts cat -l does. Nothing is run. With the options of a Flexi
    component its ports are those that these options give:

    \b
      aiorts inspect FlexiFilter -i TimedDouble -o TimedLong
    """
    if name.startswith("-"):
        raise click.NoSuchOption(name)
    import_types(modules)
    try:
        subject = find_subject(name)
    except UnknownTypeError:
        if not _inspect_running(name, options, as_json=as_json):
            raise
        return exits.DONE
    tell_of(name, "inspect")
    if subject.is_component:
        drawn = draw(subject, options, name)
        say_either(drawn.profile, lambda: _component_text(drawn), as_json=as_json)
        return exits.DONE
    if options:
        raise click.UsageError(f"{name}: {options[0]!r}: a type has no options")
    _check_type(subject, name)
    profile = {**profile_of_type(subject.cls), "package": subject.source, "source": _file_of(subject.cls)}
    say_either(profile, lambda: _type_text(profile), as_json=as_json)
    return exits.DONE


def _inspect_running(name: str, options: tuple[str, ...], *, as_json: bool) -> bool:
    """Show what runs under a name, as `aiorts cat -l` does; returns False where nothing does."""
    found = report_of(name)
    if found is None:
        return False
    if options:
        raise click.UsageError(f"{name}: {options[0]!r}: what runs has no options; see aiorts conf")
    one, report = found
    document = {"kind": one.kind, "name": one.full, **report}
    say_either(document, lambda: text_of(one.kind, one.name, one.full, report, long=True), as_json=as_json)
    return True


# -- components --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Drawn:
    """A component as the given options make it. `missing`: the options that are needed before its ports are known."""

    profile: dict[str, Any]
    options: tuple[Any, ...]
    missing: tuple[str, ...]
    command: str


def draw(subject: Subject, given: Iterable[str], name: str) -> Drawn:
    """Describe a component as the given options make it; an error in them is raised as the component raises it."""
    declaration = declaration_of(subject.cls)
    rows = tuple(getattr(subject.cls, "options", ()))
    params, missing = _parsed(declaration, rows, tuple(given), name)
    specs = {spec.name: spec for spec in declaration.parameters}
    ports = list(declaration.ports)
    make_ports = getattr(subject.cls, "make_ports", None)
    if make_ports is not None and not missing:
        component: Component = construct(subject.cls, subject.cls.__name__.lower())
        for key, value in component.params.check(params).items():
            setattr(component, key, value)
        make_ports(component)
        ports = [port.profile for port in component.ports.values()]
    checked = {key: specs[key].check(value, owner=subject.cls.__name__) for key, value in params.items()}
    profile = {
        "name": subject.cls.__name__.lower(),
        "type": declaration.type,
        "ports": [asdict(port) for port in ports],
        "params": {spec.name: plain(checked.get(spec.name, spec.default)) for spec in declaration.parameters},
        "states": {},
        "last_error": None,
        "parameters": [_parameter(spec) for spec in declaration.parameters],
        "sets": {name: plain(values) for name, values in declaration.sets.items()} if declaration.parameters else {},
        "modes": list(subject.cls.modes) if issubclass(subject.cls, MultiModeComponent) else [],
        "hooks": list(declaration.hooks),
        "doc": source_of.cleandoc(subject.cls.__doc__ or ""),
        "interface": str(getattr(subject.cls, "interface", "")),
        "needs": list(missing),
        "command": subject.command,
        "class": f"{subject.cls.__module__}:{subject.cls.__qualname__}",
        "package": subject.source,
        "source": _file_of(subject.cls),
    }
    return Drawn(profile, rows, missing, subject.command)


def _parsed(
    declaration: Declaration, rows: tuple[Any, ...], given: tuple[str, ...], name: str
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Parse the options; returns the parameters that they set, and the required flags that are missing."""
    if rows:
        options = [
            click.Option(
                [*row.flags, f"option{number}"],
                is_flag=row.kind == "flag",
                multiple=row.kind == "repeat",
                **({"flag_value": row.bare} if getattr(row, "bare", "") else {}),
            )
            for number, row in enumerate(rows)
        ]
    else:
        options = [click.Option([f"--{s.name.replace('_', '-')}", f"param_{s.name}"]) for s in declaration.parameters]
    command = click.Command(f"inspect {name}", params=list(options), add_help_option=False)
    values = command.make_context(f"aiorts inspect {name}", list(given)).params
    values = {str(key): value for key, value in values.items() if value not in (None, (), False)}
    params = {key.removeprefix("param_"): value for key, value in values.items() if key.startswith("param_")}
    modules = []
    for number, row in enumerate(rows):
        if f"option{number}" not in values:
            continue
        if row.param:
            params[row.param] = row.value if row.kind == "flag" else values[f"option{number}"]
        elif "--type-mod" in row.flags:
            modules.append(values[f"option{number}"])
    import_types(modules)
    typed = {flag for number, row in enumerate(rows) if f"option{number}" in values for flag in row.flags}
    return params, tuple(row.flags[0] for row in rows if row.flags[0] not in typed and _is_needed(row, typed))


def _is_needed(row: Any, typed: set[str]) -> bool:
    other = getattr(row, "unless", "")
    return row.required or bool(other and other not in typed)


def _parameter(spec: Any) -> dict[str, Any]:
    rule = spec.constraint
    return {
        "name": spec.name,
        "type": spec.type_text,
        "default": plain(spec.default),
        "unit": spec.unit,
        "range": {key: plain(getattr(rule, key)) for key in ("ge", "gt", "le", "lt") if getattr(rule, key) is not None},
        "choices": None if rule.choices is None else plain(rule.choices),
        "pattern": rule.pattern,
        "doc": spec.doc,
        "widget": spec.widget,
        "file": spec.names_file,
        "constraint": str(rule),
    }


def _kind(port: dict[str, Any]) -> str:
    """The type of a data port; of a service port its provided and required interfaces."""
    return ", ".join(f"{one['polarity']} {one['type']}" for one in port["interfaces"]) or str(port["type"])


def _component_text(drawn: Drawn) -> str:
    profile = drawn.profile
    parts = [_head(profile["type"], profile["doc"], profile)]
    ports = [
        (_DIRECTIONS[p["direction"]], p["name"], _kind(p), p["unit"] or "", _shape(p["shape"]), p["doc"])
        for p in profile["ports"]
    ]
    if drawn.missing:
        example = " ".join(f"{flag} ..." for flag in drawn.missing)
        interface = profile["interface"].replace("`", "")
        parts.append(
            f"Ports\n  {interface or 'by its options'}\n"
            f"  its options make them; give {' and '.join(drawn.missing)}: aiorts inspect {profile['type']} {example}"
        )
    else:
        parts.append(f"Ports\n{table(ports) or '  none'}")
    if services := _services(profile["ports"]):
        parts.append(f"Services\n{services}")
    if profile["parameters"]:
        values = profile["params"]
        rows = [
            (p["name"], p["type"], _value(values[p["name"]]), p["unit"], p["constraint"], p["doc"])
            for p in profile["parameters"]
        ]
        parts.append(f"Parameters\n{table(rows)}")
    if len(profile["sets"]) > 1:
        held = [(name, _values(values)) for name, values in profile["sets"].items()]
        parts.append(f"Configuration sets\n{table(held)}")
    if profile["modes"]:
        first, *others = profile["modes"]
        parts.append(f"Modes\n  {', '.join((f'{first} (default)', *others))}")
    parts.append(f"Hooks\n  {', '.join(profile['hooks']) or 'none'}")
    if drawn.options:
        flags = [
            (", ".join(row.flags), row.param and f"sets {row.param}", row.help, "required" if row.required else "")
            for row in drawn.options
        ]
        parts.append(f"Options\n{table(flags)}")
    if drawn.command:
        parts.append(f"Run it: aiorts {drawn.command} --help")
    return "\n\n".join(parts)


def _services(ports: Iterable[dict[str, Any]]) -> str:
    """The interfaces of the service ports, each with its methods as in Python code."""
    parts = []
    for port in ports:
        for one in port["interfaces"]:
            parts.append(f"  {port['name']}: {one['polarity']} {one['type']}")
            parts.append(table([method_text(method) for method in one["methods"]], indent="    "))
    return "\n".join(part for part in parts if part)


def method_text(method: dict[str, Any]) -> tuple[str, str]:
    """A method as in Python code, and the first line of its docstring."""
    parameters = tuple(ParameterProfile(**one) for one in method["parameters"])
    shown = MethodProfile(**{**method, "parameters": parameters})
    return str(shown), shown.doc.partition("\n")[0]


def _values(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {_value(value)}" for name, value in values.items()) or "as declared"


# -- types -------------------------------------------------------------------------------------------------------------


def _check_type(subject: Subject, name: str) -> None:
    from enum import Enum

    from aiorts.types import describe

    if not issubclass(subject.cls, Enum) and subject.cls.__module__ != "builtins":
        describe(subject.cls)  # raises DeclarationError where the class is no record type


def _type_text(profile: dict[str, Any]) -> str:
    parts = [_head(profile["name"], profile["doc"], {**profile, "class": profile["full_name"]})]
    if profile["openrtm"]:
        parts[0] += f"\n  in OpenRTM: {profile['openrtm']}"
    if profile["kind"] == "enum":
        parts.append(f"Members\n{table([(name, str(value)) for name, value in profile['members'].items()])}")
    for_fields = [
        (f["name"], f["type"], "required" if f["required"] else f"= {_value(f['default'])}", f["unit"], f["doc"])
        for f in profile.get("fields", ())
    ]
    if for_fields:
        parts.append(f"Fields\n{table(for_fields)}")
    if profile.get("example"):
        parts.append(f"As a line of JSON\n  {profile['example']}")
    return "\n\n".join(parts)


# -- in common ---------------------------------------------------------------------------------------------------------


def _head(name: str, doc: str, profile: dict[str, Any]) -> str:
    first = " ".join(doc.split("\n\n", maxsplit=1)[0].split())
    where = f"\n  {profile['source']}" if profile["source"] else ""
    return f"{name}{': ' if first else ''}{first}\n\n  {profile['package']}, {profile['class']}{where}"


def _file_of(cls: type) -> str:
    try:
        return source_of.getsourcefile(cls) or ""
    except (OSError, TypeError):
        return ""


def _shape(shape: Any) -> str:
    return "" if shape is None else f"({', '.join('any' if one == -1 else str(one) for one in shape)})"


def _value(value: Any) -> str:
    """A value on one line; a long one is cut, and a cut list has the number of its items."""
    text = '""' if value == "" else "()" if value == [] else str(value)
    if len(text) <= _WIDEST:
        return text
    return f"{text[: _WIDEST - 3]}...{f' ({len(value)} items)' if isinstance(value, list) else ''}"
