"""The design of a new component, read from the words of the command line; this module writes nothing."""

from __future__ import annotations

import keyword
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, Final

from aiorts import Component, Param
from aiorts.errors import ConfigurationError
from aiorts.types import find_type, full_name, has_tm

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9]*([-_][A-Za-z0-9]+)*")
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+|[0-9]+")
_LONGEST: Final = 60
_TRUTH: Final = MappingProxyType({"true": True, "false": False})
_ROLES: Final = ("provided", "required")


def _truth(text: str) -> bool:
    return _TRUTH[text.lower()]


def _number(text: str) -> float:
    if math.isfinite(number := float(text)):
        return number
    raise ValueError(text)


_KINDS: Final[Mapping[str, tuple[Callable[[str], Any], Any]]] = MappingProxyType(
    {"bool": (_truth, False), "int": (int, 0), "float": (_number, 0.0), "str": (str, "")}
)
"""The reader of a parameter of each kind, and its default."""
IMPORTED: Final = frozenset(
    ("Any", "Component", "InPort", "Mapping", "OutPort", "Param", "Protocol", "Provided", "Required")
)
"""Names that the component's file may import."""
_TAKEN: Final = frozenset(("ask", "self", "types", *(name for name in dir(Component) if not name.startswith("_"))))


@dataclass(frozen=True, slots=True)
class Port:
    """A data port."""

    name: str
    """The name of the attribute."""
    cls: type
    label: str = ""
    """The name of the port, where it differs from the attribute's."""
    unit: str = ""
    doc: str = ""

    @property
    def type(self) -> str:
        """The name of the port's type."""
        return self.cls.__name__

    @property
    def module(self) -> str:
        """The module from which the type is imported."""
        module = full_name(self.cls).partition(":")[0]
        return "aiorts.types" if module.startswith("aiorts.types.") else module


@dataclass(frozen=True, slots=True)
class Service:
    """A service port and its interface."""

    name: str
    role: str
    """"provided" or "required"."""
    interface: str
    """The name of the protocol."""
    label: str = ""
    """The name of the port, where it differs from the attribute's."""
    doc: str = ""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the component."""

    name: str
    default: Any
    unit: str = ""
    doc: str = ""
    constraint: str = ""
    widget: str = ""

    def declared(self) -> Any:
        """The declaration as in a class body; DeclarationError where it is not valid."""
        spec = Param(self.default, unit=self.unit, doc=self.doc, constraint=self.constraint or None, widget=self.widget)
        type("Checked", (Component,), {self.name: spec})
        return spec


@dataclass(frozen=True, slots=True)
class Design:
    """The design of a component to write."""

    name: str
    """The name of the folder, the project and the command."""
    ins: tuple[Port, ...] = ()
    outs: tuple[Port, ...] = ()
    params: tuple[Parameter, ...] = ()
    services: tuple[Service, ...] = ()
    flexi: bool = False
    """Whether the component's ports follow from parameters."""
    doc: str = ""
    """The purpose of the component, for its docstring."""
    offered: str = ""
    """The name of its entry point, where it differs from the class's."""
    rate: float = 10.0
    """Hz of the context in the system file."""

    @property
    def type(self) -> str:
        """The name of its entry point."""
        return self.offered or self.cls

    @property
    def cls(self) -> str:
        """The name of the class."""
        return pascal(self.name)

    @property
    def package(self) -> str:
        """The name of the package."""
        return "_".join(("aiorts", *(word.lower() for word in _WORDS.findall(self.name))))


def design(
    name: str,
    ins: Sequence[str] = (),
    outs: Sequence[str] = (),
    params: Sequence[str] = (),
    services: Sequence[str] = (),
    *,
    flexi: bool = False,
    described: Design | None = None,
) -> Design:
    """Make the design of a component from words of the command line.

    Args:
        name: letters, digits, - and _.
        ins, outs: "PORT:TYPE".
        params: "NAME[:KIND][=DEFAULT]", KIND bool, int, float or str.
        services: "NAME[:provided]" or "NAME:required".
        flexi: ports follow from parameters; `ins` and `outs` are then empty.
        described: the design from a file, to which the words are added.

    Raises:
        ConfigurationError: a word is wrong; the text names it and what is expected.
        UnknownTypeError: there is no such type.
        DeclarationError: a type is no record.
    """
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        raise ConfigurationError(f"{name!r:.80}: expected a name of letters, digits, - and _ that begins with a letter")
    known = described or Design(name)
    if flexi and (ins or outs or known.ins or known.outs):
        raise ConfigurationError("--flexi: its ports follow from parameters; leave --in, --out and --from away")
    made = replace(
        known,
        name=name,
        ins=(*known.ins, *(_port("--in", word) for word in ins)),
        outs=(*known.outs, *(_port("--out", word) for word in outs)),
        params=(*known.params, *(_param(word) for word in params)),
        services=(*known.services, *(_service(word) for word in services)),
        flexi=flexi,
    )
    if find_spec(made.package) is not None:
        raise ConfigurationError(f"{name}: there is a package {made.package} already; choose another name")
    _check_distinct(made)
    return made


def pascal(name: str) -> str:
    """The name in the form of class names."""
    return "".join(word[0].upper() + word[1:] for word in _WORDS.findall(name))


def _port(option: str, word: str) -> Port:
    name, sign, type_name = word.partition(":")
    if not sign or not type_name:
        raise ConfigurationError(f"{option} {word!r:.80}: expected PORT:TYPE, such as {name or 'pose'}:TimedPose2D")
    cls = find_type(type_name)
    has_tm(cls)  # raises where the type is no record
    return Port(attribute(option, name), cls)


def _param(word: str) -> Parameter:
    head, sign, text = word.partition("=")
    name, colon, kind = head.partition(":")
    name = attribute("--param", name)
    if colon and kind not in _KINDS:
        raise ConfigurationError(f"--param {word!r:.80}: expected one of {', '.join(_KINDS)} after the colon")
    if not sign:
        return Parameter(name, _KINDS[kind or "float"][1])
    for each in (kind,) if kind else _KINDS:
        try:
            return Parameter(name, _KINDS[each][0](text))
        except (ValueError, KeyError):
            continue
    raise ConfigurationError(f"--param {word!r:.80}: {text!r:.40} is no {kind}")


def _service(word: str) -> Service:
    name, sign, role = word.partition(":")
    if (role or sign) and role not in _ROLES:
        raise ConfigurationError(f"--service {word!r:.80}: expected NAME:provided or NAME:required")
    return Service(attribute("--service", name), role or "provided", pascal(name))


def attribute(option: str, name: str) -> str:
    """Check a name for an attribute of a component; returns it."""
    if not name.isidentifier() or not name.isascii() or name.startswith("_") or len(name) > _LONGEST:
        raise ConfigurationError(f"{option} {name!r:.80}: expected a name of letters, digits and _, as in Python")
    if keyword.iskeyword(name) or name in _TAKEN:
        raise ConfigurationError(f"{option} {name}: Python or every component has this name already; choose another")
    return name


def _check_distinct(made: Design) -> None:
    ports = (*made.ins, *made.outs)
    names = [*(one.name for one in ports), *(one.name for one in made.services), *(one.name for one in made.params)]
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigurationError(f"{name}: is given twice; each port, parameter and service has a name of its own")
        seen.add(name)
    classes = [made.cls, *(one.interface for one in made.services)]
    taken = IMPORTED | {one.type for one in ports}
    for name in names:
        if name in taken or name in classes:
            raise ConfigurationError(f"{name}: is the name of a class that is used; choose another")
    for number, cls in enumerate(classes):
        if cls in taken or cls in classes[:number]:
            raise ConfigurationError(f"{cls}: two classes of {made.name} would have this name; choose another")
