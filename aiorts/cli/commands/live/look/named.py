"""The meaning of a word to commands that look: a component or port, else a context or connector, else a kernel.

A component comes first; `name/` is the kernel of that name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from aiorts.cli.commands.live.target import Found, Kernels, Running, is_glob, the_one
from aiorts.errors import AbsentError, AmbiguousError, NoAnswerError
from aiorts.late import dataclass
from aiorts.spelling import suggestion


@dataclass(frozen=True, slots=True)
class Named:
    """One thing that a word means: a kernel, component, port, context or connector."""

    running: Running
    kind: str
    """"kernel", "component", "port", "context" or "connector"."""
    name: str
    """The name within the kernel; "" for the kernel itself."""
    outline: Mapping[str, Any] | None = None
    """The outline of a port's component: its type, ports and parameters."""

    @property
    def full(self) -> str:
        """The name with the kernel's name before it."""
        return f"{self.running.name}/{self.name}"

    def report(self) -> Mapping[str, Any]:
        """Ask the kernel for the report of this thing: a part of the profile, for the kernel the whole."""
        client = self.running.client
        if self.kind == "kernel":
            whole: Mapping[str, Any] = client.call("profile")
            return whole
        component = self.name.partition(".")[0]
        asked = {"port": ("components", component)}.get(self.kind, (f"{self.kind}s", self.name))
        part: Mapping[str, Any] = client.call("part", **{asked[0]: [asked[1]]})
        return part


def named(found: Kernels, word: str) -> tuple[Named, ...]:
    """Find what a word means; in it, * ? [] stand for any characters.

    Raises:
        AbsentError: nothing has the name.
        AmbiguousError: several things have the name, and the word has no such character.
        NoAnswerError: nothing has the name, and a kernel that may have it does not answer.
        InvalidNameError: the word has more parts than a name.
    """
    meant: list[Named] = []
    missing: Exception | None = None
    try:
        for one in found.all(word):
            meant += _parts(one)
    except AmbiguousError:
        raise
    except (AbsentError, NoAnswerError) as error:
        missing = error
    if meant := meant or list(_others(found, word)):
        if not is_glob(word):
            the_one(word, meant, [one.full for one in meant])
        return tuple(meant)
    raise missing or _no_port(found.all(word)[0], word)


def _parts(one: Found) -> Iterator[Named]:
    if not one.port:
        yield Named(one.running, "component" if one.component else "kernel", one.component)
        return
    outline = outlines(one.running, one.component)[one.component]
    for port in outline["ports"]:
        if fnmatchcase(port, one.port):
            yield Named(one.running, "port", f"{one.component}.{port}", outline)


def _others(found: Kernels, word: str) -> Iterator[Named]:
    kernel, _, rest = word.rpartition("/")
    for one in found.running:
        if kernel and not one.fits(kernel):
            continue
        for kind in ("context", "connector"):
            names = (name for name in one.names[f"{kind}s"] if fnmatchcase(name, rest))
            yield from (Named(one, kind, name) for name in names)
        if not kernel and one.fits(word):
            yield Named(one, "kernel", "")


def _no_port(one: Found, word: str) -> AbsentError:
    ports = list(outlines(one.running, one.component)[one.component]["ports"])
    listed = f"its ports: {', '.join(ports[:10]) or 'none'}"
    hint = suggestion(one.port, ports, listed, shown=lambda near: f"{one.component}.{near}")
    return AbsentError(f"{word}: {one.component} has no such port; {hint}")


def outlines(running: Running, *components: str) -> Mapping[str, Any]:
    """The type, ports and parameters of components, by name; of all components where no name is given."""
    found: Mapping[str, Any] = running.client.call("outline", components=components)
    return found
