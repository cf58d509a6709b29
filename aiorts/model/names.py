"""Names and paths: this file decides which names are allowed and how a path is read; it looks nothing up.

The grammar, the same for kernels, components, component types, ports, parameters and contexts:

    name   letters a-z A-Z, digits, "_" and "-"; the first is no "-"; 1 to 100 characters
    host   a name that may hold single dots inside ("robot.local", "192.168.0.7"); 1 to 253 characters
    path   [[host "/"] kernel "/"] component ["." port]

Every refused character means something to a key expression, a shell, a URL or a system file, so a name can be written
in any of them without quotes. A leading "-" would read as an option on a command line.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from aiorts.errors import InvalidNameError
from aiorts.late import dataclass

MAX_NAME_LENGTH = 100
MAX_HOST_LENGTH = 253
ALLOWED = "letters a-z A-Z, digits, '_' and '-', not starting with '-', 1 to 100 characters"

_ALLOWED_HOST = "letters a-z A-Z, digits, '_', '-' and single dots inside, not starting with '-', 1 to 253 characters"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,99}")
_HOST = re.compile(r"(?=.{1,253}\Z)[A-Za-z0-9_][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)*")
_REFUSED = re.compile(r"[^A-Za-z0-9_-]")
_REFUSED_HOST = re.compile(r"[^A-Za-z0-9_.-]")
_SHOWN_CHARACTERS = 8
_SHOWN_LENGTH = 60


def check_name(name: object, what: str) -> str:
    """The name itself when it is allowed.

    `what` is the kind of the named thing in the message ("port", "component"). Raises InvalidNameError that lists the
    refused characters and the allowed set.
    """
    if isinstance(name, str) and _NAME.fullmatch(name):
        return name
    raise InvalidNameError(f"{what} name {_shown(name)}: {_fault(name, _REFUSED, MAX_NAME_LENGTH)}; allowed: {ALLOWED}")


def check_host(host: object) -> str:
    """The host name itself when it is allowed; raises InvalidNameError otherwise."""
    if isinstance(host, str) and _HOST.fullmatch(host):
        return host
    fault = _fault(host, _REFUSED_HOST, MAX_HOST_LENGTH)
    raise InvalidNameError(f"host name {_shown(host)}: {fault}; allowed: {_ALLOWED_HOST}")


class PathParts(NamedTuple):
    """The parts of a path; None for a part that is left out."""

    host: str | None
    kernel: str | None
    component: str
    port: str | None


def split_path(text: object) -> PathParts:
    """The parts of a path, not checked: they may hold `*`, as on a command line, or be empty.

    Raises InvalidNameError for more parts than a path has.
    """
    if not isinstance(text, str):
        raise InvalidNameError(f"path {_shown(text)}: expected text, got {type(text).__name__}")
    *before, last = text.split("/")
    if len(before) > 2:
        form = "at most host/kernel/component.port"
        raise InvalidNameError(f"path {_shown(text)}: {len(before) + 1} parts between '/'; expected {form}")
    component, dot, port = last.partition(".")
    kernel = before[-1] if before else None
    return PathParts(before[0] if len(before) == 2 else None, kernel, component, port if dot else None)


@dataclass(frozen=True, slots=True, order=True)
class Path:
    """The path of a component or a port: `str(Path.parse(text)) == text` for every text that `parse` accepts.

    Raises InvalidNameError for a part that is no name, and for a host without a kernel.
    """

    component: str
    port: str = ""
    """Empty: the path means the component itself."""
    kernel: str = ""
    """Empty: the kernel that reads the path."""
    host: str = ""
    """Empty: this host."""

    def __post_init__(self) -> None:
        check_name(self.component, "component")
        if self.port != "":
            check_name(self.port, "port")
        if self.kernel != "":
            check_name(self.kernel, "kernel")
        if self.host != "":
            check_host(self.host)
            if self.kernel == "":
                raise InvalidNameError(f"path {str(self)!r}: a host needs a kernel; write host/kernel/component.port")

    @classmethod
    def parse(cls, text: str) -> Path:
        """Read "pid0", "pid0.command", "kernel/pid0.command" or "host/kernel/pid0.command".

        Raises InvalidNameError that quotes the whole path and says which part is wrong.
        """
        host, kernel, component, port = split_path(text)
        try:
            if port is not None:
                check_name(port, "port")
            if kernel is not None:
                check_name(kernel, "kernel")
            if host is not None:
                check_host(host)
            return cls(component, port or "", kernel or "", host or "")
        except InvalidNameError as error:
            # A recorded port `lidar.scan` is replayed as `lidar_scan`; other dots are refused here, too.
            port = port or ""
            flat = port.replace(".", "_")
            meant = "." in port and _NAME.fullmatch(flat) and _NAME.fullmatch(component)
            hint = f"; did you mean {text.removesuffix(port) + flat!r}?" if meant else ""
            raise InvalidNameError(f"path {_shown(text)}: {error}{hint}") from None

    def __str__(self) -> str:
        before = "".join(f"{part}/" for part in (self.host, self.kernel) if part)
        return f"{before}{self.component}.{self.port}" if self.port else f"{before}{self.component}"


def names_kernel(path: str) -> bool:
    """Whether a path names the kernel of the port or component: in a system file, another kernel than this."""
    return "/" in path


def _fault(name: object, refused: re.Pattern[str], longest: int) -> str:
    if not isinstance(name, str):
        return f"expected text, got {type(name).__name__}"
    if name == "":
        return "is empty"
    found = sorted(set(refused.findall(name)))
    if found:
        more = f" and {len(found) - _SHOWN_CHARACTERS} more" if len(found) > _SHOWN_CHARACTERS else ""
        listed = " ".join(ascii(character) for character in found[:_SHOWN_CHARACTERS])
        return f"{listed}{more} not allowed"
    if len(name) > longest:
        return f"has {len(name)} characters"
    if name[0] == "-":
        return "starts with '-'"
    return "has a dot at an end or two in a row"


def _shown(name: object) -> str:
    text = ascii(name)
    return text if len(text) <= _SHOWN_LENGTH else f"{text[:_SHOWN_LENGTH]}..."
