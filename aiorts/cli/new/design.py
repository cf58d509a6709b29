"""What a new component is to be: read from the words of the command line; it writes nothing."""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from types import MappingProxyType
from typing import Any, Final

from aiorts import Component
from aiorts.errors import ConfigurationError
from aiorts.types import find_type, full_name, has_tm

_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9]*([-_][A-Za-z0-9]+)*")
_WORDS: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+|[0-9]+")
_LONGEST: Final = 60
_TRUTH: Final = MappingProxyType({"true": True, "false": False})
_ROLES: Final = ("provided", "required")


def _truth(text: str) -> bool:
    return _TRUTH[text.lower()]


_KINDS: Final[Mapping[str, tuple[Callable[[str], Any], Any]]] = MappingProxyType(
    {"bool": (_truth, False), "int": (int, 0), "float": (float, 0.0), "str": (str, "")}
)
"""How a parameter of each kind is read, and its default."""
_IMPORTED: Final = frozenset(
    ("Any", "Component", "InPort", "Mapping", "OutPort", "Param", "Protocol", "Provided", "Required")
)
"""Names that the file of a component may import."""
_TAKEN: Final = frozenset(("ask", "types", *(name for name in dir(Component) if not name.startswith("_"))))


@dataclass(frozen=True, slots=True)
class Port:
    """A data port."""

    name: str
    cls: type

    @property
    def type(self) -> str:
        """The name of its type."""
        return self.cls.__name__

    @property
    def module(self) -> str:
        """Where it is imported from."""
        module = full_name(self.cls).partition(":")[0]
        return "aiorts.types" if module.startswith("aiorts.types.") else module


@dataclass(frozen=True, slots=True)
class Service:
    """A service port and its interface."""

    name: str
    role: str
    """"provided" or "required"."""

    @property
    def interface(self) -> str:
        """The name of the protocol."""
        return pascal(self.name)


@dataclass(frozen=True, slots=True)
class Design:
    """A component that is to be made."""

    name: str
    """Of the folder, the project and the command."""
    ins: tuple[Port, ...] = ()
    outs: tuple[Port, ...] = ()
    params: Mapping[str, Any] = field(default_factory=dict)
    """Defaults."""
    services: tuple[Service, ...] = ()
    flexi: bool = False
    """Whether its ports follow from parameters."""

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
) -> Design:
    """The component of these words.

    Args:
        name: letters, digits, - and _.
        ins, outs: "PORT:TYPE".
        params: "NAME[:KIND][=DEFAULT]", KIND bool, int, float or str.
        services: "NAME[:provided]" or "NAME:required".
        flexi: ports follow from parameters; then there are none of `ins` and `outs`.

    Raises:
        ConfigurationError: says which word is wrong, and what is expected.
        UnknownTypeError: there is no such type.
        DeclarationError: it is no record.
    """
    if not _NAME.fullmatch(name) or len(name) > _LONGEST:
        raise ConfigurationError(f"{name!r:.80}: expected a name of letters, digits, - and _ that begins with a letter")
    if flexi and (ins or outs):
        raise ConfigurationError("--flexi: its ports follow from parameters; leave --in and --out away")
    made = Design(
        name,
        tuple(_port("--in", word) for word in ins),
        tuple(_port("--out", word) for word in outs),
        MappingProxyType(dict(_param(word) for word in params)),
        tuple(_service(word) for word in services),
        flexi,
    )
    if find_spec(made.package) is not None:
        raise ConfigurationError(f"{name}: there is a package {made.package} already; choose another name")
    _check_distinct(made)
    return made


def pascal(name: str) -> str:
    """The name as classes have it."""
    return "".join(word[0].upper() + word[1:] for word in _WORDS.findall(name))


def _port(option: str, word: str) -> Port:
    name, sign, type_name = word.partition(":")
    if not sign or not type_name:
        raise ConfigurationError(f"{option} {word!r:.80}: expected PORT:TYPE, such as {name or 'pose'}:TimedPose2D")
    cls = find_type(type_name)
    has_tm(cls)  # refuses what is no record
    return Port(_attribute(option, name), cls)


def _param(word: str) -> tuple[str, Any]:
    head, sign, text = word.partition("=")
    name, colon, kind = head.partition(":")
    name = _attribute("--param", name)
    if colon and kind not in _KINDS:
        raise ConfigurationError(f"--param {word!r:.80}: expected one of {', '.join(_KINDS)} after the colon")
    if not sign:
        return name, _KINDS[kind or "float"][1]
    for each in (kind,) if kind else _KINDS:
        try:
            return name, _KINDS[each][0](text)
        except (ValueError, KeyError):
            continue
    raise ConfigurationError(f"--param {word!r:.80}: {text!r:.40} is no {kind}")


def _service(word: str) -> Service:
    name, sign, role = word.partition(":")
    if (role or sign) and role not in _ROLES:
        raise ConfigurationError(f"--service {word!r:.80}: expected NAME:provided or NAME:required")
    return Service(_attribute("--service", name), role or "provided")


def _attribute(option: str, name: str) -> str:
    """A name that an attribute of a component can have."""
    if not name.isidentifier() or not name.isascii() or name.startswith("_") or len(name) > _LONGEST:
        raise ConfigurationError(f"{option} {name!r:.80}: expected a name of letters, digits and _, as in Python")
    if keyword.iskeyword(name) or name in _TAKEN:
        raise ConfigurationError(f"{option} {name}: Python or every component has this name already; choose another")
    return name


def _check_distinct(made: Design) -> None:
    ports = (*made.ins, *made.outs)
    names = [*(one.name for one in ports), *(one.name for one in made.services), *made.params]
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ConfigurationError(f"{name}: is given twice; each port, parameter and service has a name of its own")
        seen.add(name)
    classes = [made.cls, *(one.interface for one in made.services)]
    taken = _IMPORTED | {one.type for one in ports}
    for number, cls in enumerate(classes):
        if cls in taken or cls in classes[:number]:
            raise ConfigurationError(f"{cls}: two classes of {made.name} would have this name; choose another")
