"""Write the reference pages of the guide from the code. Run: python tests/reference.py

Each page is one function without arguments that gives its text. Descriptions are the docstrings and help texts
themselves: what is unclear on a page is corrected there. A test fails when a page is stale.
"""

from __future__ import annotations

import ast
import inspect
import os
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import click

from aiorts.guide import pages
from aiorts.tiers import NOT_STABLE, tier_of_page
from reference_api import api, events, statistics
from reference_operations import operations
from reference_source import WIDTH, block, doc_of, item, listed, one_line

ROOT: Final = Path(__file__).parents[1]
FOLDER: Final = ROOT / "aiorts" / "guide" / "pages" / "reference"
_PROSE: Final = 120
_SPECIAL: Final = re.compile(r" *(?:[-*+] |[|#>]|\d+[.)] )")
"""What a line of prose may not begin with: Markdown takes it for something else."""
_STALE: Final = "<!-- Written by tests/reference.py from the code: correct the docstrings and help texts there. -->\n"

HEADS: Final = {
    "api": """# Public names

Every name that a program or a plugin may import, by module, with its signature, what it raises and what it has.

A name that is not here is internal and may change.""",
    "system-file": """# System files

Every table and key of a system file, the TOML file that `aiorts run` runs, with type, default and meaning.

`aiorts check FILE` finds mistakes. `aiorts schema` prints the same as a JSON Schema for editors. A parameter that is a
number or true or false may also be written as the text that means it, such as `"0x10"` or `"yes"`.""",
    "command-line": """# The command line

Every command of `aiorts` with its arguments and options, as `aiorts COMMAND --help` shows them.

Each also has `-h, --help`. [Exit status](exit-status.md) and [error codes](error-codes.md) have their own pages.""",
    "error-codes": """# Error codes

Every code that a message of aiorts begins with, what it means, its usual cause and what to do.

A message reads `aiorts: E-CODE: where: cause; what to do`. `E-` is an error, `W-` a warning, `N-` a note of
`aiorts check`. `aiorts help errors E-CODE` shows one of them. What a command ends with, [exit status](exit-status.md)
says.""",
    "exit-status": """# Exit status

The status that each command of `aiorts` ends with, for scripts and service managers.""",
    "record-types": """# Record types

Every record and enumeration that comes with aiorts, with its fields, their units and their meaning.

A port may have each of them as its type, and also `bool`, `int`, `float`, `str`, `bytes` and records of your own. `tm`
is the time stamp, in nanoseconds since the epoch. Numbers are named by kind and size: `i16` is an integer of 16 bits,
`u8` one of 8 bits without sign, `f64` a float of 64 bits. `seq[f64]` is a sequence. `aiorts inspect NAME` shows one
type with its defaults and a line of JSON.""",
    "flexi": """# Flexi components

The options and parameters of the seven components whose ports are chosen when they start, for the command line and for
system files.

Each is a Unix filter (`aiorts flexiadd`) that reads and writes lines of JSON, and a type for system files
(`type = "FlexiAdd"`), with `options` as on the command line or `params` by name. A mistake in a type, a map or a
constant is refused when the component is created; the message marks its place in the text.""",
    "events": """# Events

Every event of `aiorts.events` with its fields, for programs that observe a kernel.

`kernel.bus.subscribe(StateChanged, observer)` calls `observer` with each event of that class and of the classes derived
from it. Each event also has `sequence: int`, its number on the bus of its kernel. A time is in nanoseconds where its
name ends with `_ns`, else in seconds.""",
    "operations": """# Operations of a kernel

Everything that a client can ask a kernel for, with the right that it needs, its arguments, and what it answers.

Commands, `aiorts.sessions` and other carriers all go by this table. A call is a name with arguments; it has one answer,
and an operation that streams goes on with items until it ends or is cancelled. In an answer a field that has a default
may be left out. Any value may be where a parameter, a sample or a user's method decides, and nowhere else.

**Who only looks** (right `view`) changes nothing that lasts, and runs no code: `catalogue` imports a package only for
who may operate. One thing may be switched on: `counters` has connectors `measured` as long as its stream lasts, at most
16 for a stream and 64 of a kernel in all; `measure` needs `operate`. All streams of `monitor` and `counters` together
take at most a fifth of a kernel's loop: beyond that they look less often than they were asked to.

**The same kernel, restarted**: hello, `names` and `profile` have `lasting`, a name that stays: "host/NAME" of a kernel
that was given one (`--name`), else "host/PROGRAM:FILE" of what it runs. Several that run the same have the same, and
`address` and `epoch` tell them apart.

**Assembled**: while a system file is made into a system, `assembled` is false in `names` and `profile`; then the event
`Assembled` comes, and it is true. It is null where a program makes its components itself.

**In simulated time** `monitor` and `counters` go by the real clock, and look between two instants: a timer of the
simulated clock would change what happens.""",
    "statistics": """# Statistics and profiles

Every class of counts, times and descriptions that a kernel gives, with fields and units.

All are frozen: a value describes one moment and does not change. A field whose name ends with `_ns` is in nanoseconds.
`kernel.profile()` gives the whole system, and `kernel.profile().to_json()` the same as JSON, with the schema
`aiorts.profile_schema()`.""",
}
"""The beginning of each page."""


# -- system files ------------------------------------------------------------------------------------------------------


def system_file() -> str:
    from aiorts.system import schema

    made = schema(templates=False)
    parts = []
    top = made["properties"]
    parts.append("## At the top\n\n" + _keys({"schema": top.pop("schema")}, made["required"]))
    include = top.pop("include")
    parts.append(_table("[[include]]", {**include["items"], "description": include["description"]}))
    variables = top.pop("variables")
    parts.append(_table("[variables]", variables))
    parts.append(_table("[plugins]", top.pop("plugins"), "Where to look for components besides installed packages."))
    clock = top.pop("clock")
    kinds = [word for one in clock["oneOf"] for word in _words(one["properties"]["kind"])]
    speed = _key("speed", clock["oneOf"][1]["properties"]["speed"], required=False).rstrip()
    parts.append(
        f"## `[clock]`\n\n{_sentence(clock['description'])}\n\n"
        f"{_key('kind', {'enum': kinds, 'default': 'system'}, required=False)}"
        f'{speed} Required with kind `"scaled"`, and only there.\n'
    )
    component = made["$defs"]["component"]["oneOf"][-1]
    parts.append(
        f"## `[components.NAME]`\n\n{_sentence(top.pop('components')['description'])}\n\n"
        + _keys(
            {
                **component["properties"],
                "type": {
                    "type": "string",
                    "description": f"An installed component by name; {component['properties']['type']['description']}.",
                },
                "params": {"type": "object", "description": "[components.NAME.params]: parameters by name."},
                "supervision": {"type": "object", "description": "See [components.NAME.supervision]."},
                "start": {"type": "object", "description": "See [components.NAME.start]."},
                "limits": {"type": "object", "description": "See [components.NAME.limits]."},
            },
            ["type"],
        )
    )
    tables = {**made["$defs"], "limits": component["properties"]["limits"]}
    parts += [_table(f"[components.NAME.{name}]", tables[name]) for name in ("supervision", "start", "limits")]
    parts.append(_table("[composites.NAME]", made["$defs"]["composite"]))
    top.pop("composites")
    parts.append(_table("[[connections]]", made["$defs"]["connection"], top.pop("connections")["description"]))
    parts.append(_contexts(top.pop("contexts"), made["$defs"]["context"]["oneOf"]))
    for name, table in top.items():
        listed = table.get("type") == "array"
        parts.append(
            _table(f"[[{name}]]", table["items"], table["description"]) if listed else _table(f"[{name}]", table)
        )
    return "\n".join(parts)


def _contexts(table: Mapping[str, Any], kinds: list[dict[str, Any]]) -> str:
    out = f"## `[contexts.NAME]`\n\n{_sentence(table['description'])}\n"
    shared = {
        name: value
        for name, value in kinds[0]["properties"].items()
        if name != "kind" and all(one["properties"].get(name) == value for one in kinds)
    }
    words = [one["properties"]["kind"]["const"] for one in kinds]
    out += f"\n- `kind`: {_choice(words)}; required.\n" + _keys(shared, kinds[0]["required"])
    for one in kinds:
        kind = one["properties"]["kind"]
        rest = {name: value for name, value in one["properties"].items() if name != "kind" and name not in shared}
        out += f'\n### `kind = "{kind["const"]}"`\n\n{one_line(kind.get("description", ""))}\n\n' + _keys(
            rest, one["required"]
        )
    return out


def _sentence(text: str) -> str:
    """A description without the table's name that stands before it."""
    said = re.sub(r"^\[\[?[\w.]+\]\]?: ", "", text)
    return said[:1].upper() + said[1:]


def _table(name: str, table: Mapping[str, Any], text: str = "") -> str:
    said = _sentence(table.get("description", text))
    return f"## `{name}`\n\n{said}\n\n{_keys(table['properties'], table.get('required', ()))}"


def _keys(table: Mapping[str, Any], required: Iterable[str]) -> str:
    return "".join(_key(name, value, required=name in set(required)) for name, value in table.items())


def _key(name: str, value: Mapping[str, Any], *, required: bool) -> str:
    facts = [_kind(value)]
    if required:
        facts.append("required")
    if "default" in value and value["default"] is not None:
        facts.append(f"default `{_toml(value['default'])}`")
    text = _ticked(one_line(value.get("description", "").replace("\n", " ")))
    told = "; ".join(fact for fact in facts if fact)
    below = value.get("properties", {})
    more = f" Its keys: {listed(below)}, each a {_kind(next(iter(below.values())))}." if below else ""
    return item(name, f"{f'{told}. ' if told else ''}{text}{more}".strip()) + "\n"


def _ticked(text: str) -> str:
    """The text with names of tables as code, which Markdown would take for links."""
    return re.sub(r"(?<![`\w])(\[\[?[a-z_]+(?:\.[A-Za-z_]+)*\]?\])(?!`)", r"`\1`", text)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value).replace("'", '"')


def _words(value: Mapping[str, Any]) -> list[str]:
    return [value["const"]] if "const" in value else list(value.get("enum", ()))


def _choice(words: Iterable[Any]) -> str:
    return "one of " + ", ".join(f"`{_toml(word)}`" for word in words)


_KINDS: Final = {
    "object": "table",
    "array": "array",
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
}
_LIMITS: Final = {"minimum": "at least", "exclusiveMinimum": "above", "maximum": "at most", "exclusiveMaximum": "below"}


def _kind(value: Mapping[str, Any]) -> str:
    if words := _words(value):
        return _choice(words) if len(words) > 1 else f"always `{_toml(words[0])}`"
    if several := value.get("anyOf"):
        found = [_kind(one) for one in several if "pattern" not in one or one is several[0]]
        found = [one for one in found if "true or false" not in found or not one.startswith("one of")]
        return " or ".join(dict.fromkeys(found))
    kind = value.get("type", "")
    kinds = [kind] if isinstance(kind, str) else list(kind)
    if "array" in kinds and isinstance(items := value.get("items"), dict):
        inner = items.get("type", "")
        plural = {"string": "array of texts", "number": "array of numbers", "array": "array of arrays of texts"}
        kinds[kinds.index("array")] = plural.get(inner, "array") if isinstance(inner, str) else "array"
    said = " or ".join(_KINDS.get(one, one) for one in kinds)
    limits = [f"{word} {_shown(value[name])}" for name, word in _LIMITS.items() if name in value]
    if "maxLength" in value:
        limits.append(f"at most {_shown(value['maxLength'])} characters")
    return f"{said}, {', '.join(limits)}" if limits else said


def _shown(number: float) -> str:
    return f"{number:,}" if isinstance(number, int) else f"{number:g}"


# -- the command line --------------------------------------------------------------------------------------------------


def command_line() -> str:
    from aiorts.cli.app import aiorts

    return "\n".join(_commands(aiorts, click.Context(aiorts, info_name="aiorts"), 2))


def _commands(command: click.Command, context: click.Context, depth: int) -> Iterator[str]:
    yield f"{'#' * depth} `{context.command_path}`\n\n{_command(command, context)}"
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None and not below.hidden:
                yield from _commands(below, click.Context(below, parent=context, info_name=name), min(depth + 1, 3))


def _command(command: click.Command, context: click.Context) -> str:
    usage = " ".join([context.command_path, *command.collect_usage_pieces(context)])
    out = block(textwrap.fill(usage, WIDTH, subsequent_indent="    ", break_on_hyphens=False))
    out += _help(command.help or "")
    options = [one for one in command.params if isinstance(one, click.Option) and not one.hidden]
    if options:
        out += "\nOptions:\n\n" + "".join(_option(one) for one in options)
    if context.command_path == "aiorts run":
        for name, found in _of_services(command).items():
            out += f"\nOptions of the service `{name}`:\n\n" + "".join(_option(one) for one in found)
    return out


def _of_services(command: click.Command) -> Mapping[str, list[click.Option]]:
    from aiorts.cli.runtime import service_options

    found: Mapping[str, list[click.Option]] = service_options._found((), command.params)[0]
    return found


def _help(text: str) -> str:
    """The help of a command: what it marks to stay as it is becomes code."""
    out = []
    for paragraph in inspect.cleandoc(text).split("\n\n"):
        if paragraph.startswith("\b\n"):
            out.append(f"```text\n{textwrap.dedent(paragraph[2:])}\n```")
        else:
            out.append(_ticked(one_line(paragraph)))
    return "\n\n".join(out) + "\n"


def _option(option: click.Option) -> str:
    names = ", ".join(option.opts) + "".join(f" / {name}" for name in option.secondary_opts)
    kind = option.type
    value = ""
    if not option.is_flag and not option.count:
        value = "|".join(map(str, kind.choices)) if isinstance(kind, click.Choice) else kind.name.split(" ")[0].upper()
        value = f" {option.metavar or value}"
    text = re.sub(r"(?<!\.)\.$", "", _ticked(one_line(option.help or "")))
    more = "; ".join(
        fact for fact in _facts(option) if fact not in text and not (fact == "repeatable" and _TOLD.search(text))
    )
    parts = [text if not text or text.endswith(".") else f"{text}.", f"{more[:1].upper()}{more[1:]}." if more else ""]
    return item(f"{names}{value}", " ".join(filter(None, parts))) + "\n"


_TOLD: Final = re.compile(r"repeat|more than once")
"""Words of a help text that says that an option may be repeated."""


def _facts(option: click.Option) -> Iterator[str]:
    kind = option.type
    if isinstance(kind, click.IntRange | click.FloatRange):
        low, high = "above" if kind.min_open else "at least", "below" if kind.max_open else "at most"
        bounds = [f"{low} {kind.min}"] if kind.min is not None else []
        bounds += [f"{high} {kind.max}"] if kind.max is not None else []
        yield " and ".join(bounds)
    if option.required:
        yield "required"
    if option.multiple:
        yield "repeatable"
    if type(option.default) in (str, int, float) and option.default != "" and not option.is_flag:
        yield f"default `{option.default}`"


# -- codes and statuses ------------------------------------------------------------------------------------------------


def error_codes() -> str:
    from aiorts import errors
    from aiorts.cli.console.codes import CODES
    from aiorts.guide import anchor

    raised: dict[str, list[str]] = {}
    for name in errors.__all__:
        cls = getattr(errors, name)
        if isinstance(cls, type) and issubclass(cls, errors.AiortsError):
            raised.setdefault(cls.code, []).append(f"aiorts.errors.{name}")
    parts = ["".join(f"- [`{code}`](#{anchor(code)}): {one.meaning}\n" for code, one in sorted(CODES.items()))]
    for code, one in sorted(CODES.items()):
        lines = [f"- Cause: {one.cause}", f"- Remedy: {one.remedy}"]
        if code in raised:
            lines.append(f"- Raised as {listed(raised[code])}.")
        parts.append(f"## `{code}`\n\n{one.meaning}\n\n" + "\n".join(lines) + "\n")
    return "\n".join(parts)


def exit_status() -> str:
    from aiorts import exits

    names = {str(value): name for name in exits.__all__ if isinstance(value := getattr(exits, name), int)}
    lines = []
    for status, meaning in exits.TABLE:
        name = f" (`aiorts.exits.{names[status]}`)" if status in names else ""
        lines.append(f"- `{status}`{name}: {_ticked(meaning)}.\n")
    return (
        f"{''.join(lines)}\n"
        "A component, a type or a port that a command names and that is not there makes it end with `6`; one that a "
        "file names, or that a command was to start, with `2`: then nothing was started. "
        "A component ends `aiorts run` with a status of its own by `self.kernel.request_stop(status)`. A filter that "
        "could not read a line goes on and ends with `1`. A command for what runs ends with `6` where the kernel ends "
        "meanwhile; one that only follows it, such as `print` or `top`, with `0`, unless `--count` asked for more. "
        "Which error a message is about says its code: "
        "[error codes](error-codes.md).\n"
    )


# -- record types ------------------------------------------------------------------------------------------------------

_GROUPS: Final = {
    "basic": "Basic records of OpenRTM",
    "extended": "Extended records of OpenRTM",
    "interface": "Records of OpenRTM's device interfaces",
    "extra": "Further records",
    "ros": "Messages of ROS 2",
}


def record_types() -> str:
    from aiorts import types
    from aiorts.cli.commands.record_types import profile_of_type
    from aiorts.types import all_types, ros

    ours = {id(getattr(module, name)) for module in (types, ros) for name in module.__all__}
    profiles = [profile_of_type(cls) for cls in all_types().values() if id(cls) in ours]
    parts = []
    for group, title in _GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [_record(one) for one in profiles if one["group"] == group]
    return "\n".join(parts)


def _record(profile: Mapping[str, Any]) -> str:
    said = doc_of(profile["doc"]).first
    if profile["openrtm"]:
        said += f" `{profile['openrtm'].split(' ')[0]}` of OpenRTM."
    out = f"### `{profile['name']}`\n\n{said.strip()}\n\n"
    if profile["kind"] == "enum":
        return out + "".join(f"- `{name}` = {value}\n" for name, value in profile["members"].items())
    for one in profile["fields"]:
        unit = f" [{one['unit']}]" if one["unit"] else ""
        text = "" if one["name"] == "tm" else one["doc"]
        out += item(f"{one['name']}: {one['type']}{unit}", one_line(text)) + "\n"
    return out


# -- Flexi components --------------------------------------------------------------------------------------------------


def flexi() -> str:
    from aiorts_flexi.readme import COMPONENTS

    parts = []
    for cls in sorted(COMPONENTS, key=lambda cls: cls.__name__):
        paragraphs = [_ticked(one_line(one)) for one in inspect.cleandoc(cls.__doc__ or "").split("\n\n")]
        parts.append(f"## {cls.__name__}\n\n" + "\n\n".join(paragraphs) + f"\n\nPorts: {cls.interface}.\n")
        if cls.help_text:
            parts.append(_help(cls.help_text))
        parts.append("Options:\n")
        for one in cls.options:
            sets = f" Sets `{one.param}`." if one.param else ""
            needed = " Required." if one.required else ""
            parts[-1] += "\n" + item(", ".join(one.flags), f"{one.help}.{needed}{sets}")
        parts[-1] += "\n"
        parts.append("Parameters:\n")
        for each in cls("x").params.values():
            limits = str(each.spec.constraint)
            if limits and not limits.startswith("one of"):
                limits = f"`{limits}`"
            unit = f" [{each.spec.unit}]" if each.spec.unit else ""
            default = str(each.spec.default) if isinstance(each.spec.default, Path) else each.spec.default
            allowed = f"; {limits}" if limits else ""
            parts[-1] += "\n" + item(
                f"{each.name}: {each.spec.type_text}{unit} = {default!r}", f"{each.spec.doc.rstrip('.')}{allowed}."
            )
        parts[-1] += "\n"
    return "\n".join(parts)


PAGES: Final[Mapping[str, Callable[[], str]]] = {
    "api": api,
    "system-file": system_file,
    "command-line": command_line,
    "error-codes": error_codes,
    "exit-status": exit_status,
    "record-types": record_types,
    "flexi": flexi,
    "events": events,
    "statistics": statistics,
    "operations": operations,
}


def page(name: str) -> str:
    """The text of a page as it ought to be now."""
    text = _folded(re.sub(r"\n{3,}", "\n\n", f"{HEADS[name]}\n\n{PAGES[name]()}").rstrip())
    return noted(name, f"{text}\n\n{_STALE}")


def _literal(line: str) -> str:
    """The line, with what Markdown would take for HTML or for bold text as code."""
    parts = line.split("`")
    parts[::2] = [re.sub(r"[^\s,;(]*(?:<[A-Za-z]|\w\*\*\w)[^\s,;)]*(?<!\.)", r"`\g<0>`", part) for part in parts[::2]]
    return "`".join(parts)


def _folded(text: str) -> str:
    """The text with lines of prose no longer than those of other pages."""
    out, fenced = [], False
    for line in text.splitlines():
        fenced ^= line.startswith("```")
        if not fenced and not line.startswith(("#", "<!--", "```")):
            line = _literal(line)
        if fenced or len(line) <= _PROSE or line.startswith(("#", "<!--")):
            out.append(line)
            continue
        after = "  " if line.startswith("- ") else ""
        lines = textwrap.wrap(line, _PROSE, subsequent_indent=after, break_long_words=False, break_on_hyphens=False)
        out += [line] if any(_SPECIAL.match(one) for one in lines[1:]) else lines
    return "\n".join(out)


LINKS: Final = FOLDER.parent / "explanation" / "links.md"
"""A page with a part that is written from the table of a link's negotiation."""
_ROLES: Final = {
    "offers": "The writer's end",
    "requests": "The reader's end, connected by its own kernel",
    "answers": "The reader's end, connected by the writer's kernel",
}
_PART: Final = re.compile(r"(?<=correct the table there\. -->\n).*(?=<!-- End of)", re.DOTALL)


def _begun_small(text: object) -> str:
    """A docstring as it stands in a cell of a table."""
    return f"{str(text)[0].lower()}{str(text)[1:].removesuffix('.')}"


def links_page(text: str) -> str:
    """The page of links as it ought to be now, with the events and the diagrams of the table."""
    from aiorts.model.links import negotiation
    from aiorts.model.links.negotiation import LinkEvent, LinkRole, mermaid

    (events,) = (
        one.body
        for one in ast.parse(inspect.getsource(negotiation)).body
        if isinstance(one, ast.ClassDef) and one.name == LinkEvent.__name__
    )
    texts = [one.value.value for one in events if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)]
    rows = [f"| {event.value} | {_begun_small(text)} |\n" for event, text in zip(LinkEvent, texts[1:], strict=True)]
    parts = ["\n## The events\n\n| event | meaning |\n|---|---|\n", *rows]
    parts += [f"\n## {_ROLES[role]}\n\n```mermaid\n{mermaid(role)}```\n" for role in LinkRole]
    return _PART.sub("".join(parts) + "\n", text)


_NOTE: Final = re.compile(rf"^\*(?:{'|'.join(tier.name for tier in NOT_STABLE)}): .*\*\n\n", re.MULTILINE)


def noted(name: str, text: str) -> str:
    """The page with the line of its tier below the title, or without one where it is about something stable."""
    tier, bare = tier_of_page(name), _NOTE.sub("", text)
    return bare if tier is None else bare.replace("\n\n", f"\n\n{tier.note}\n\n", 1)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).with_name("architecture")))
    os.environ.pop("AIORTS_PLUGINS", None)
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or PAGES:
        (FOLDER / f"{name}.md").write_text(page(name), encoding="utf-8")
        print(f"{FOLDER / name}.md")
    LINKS.write_text(links_page(LINKS.read_text(encoding="utf-8")), encoding="utf-8")
    print(LINKS)
    for one in pages():
        one.path.write_text(noted(one.name, one.text), encoding="utf-8")
