"""Answers to what other kernels ask about links: with the versions that this kernel speaks; a refusal is logged.

Also the tables in which it is found without a walk over all links which one they mean: there may be thousands.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from aiorts.errors import WiringError
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.links import versions
from aiorts.links.messages import Answer

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.links.arrivals import Link
    from aiorts.links.reader_link import ReaderLink
    from aiorts.links.transport import Caller
    from aiorts.model.names import Path

_LOG: Final = KernelLog()
Name: TypeAlias = tuple[str, str]


def name_of(caller: Caller) -> str:
    """Of who asks, as the transport knows it."""
    return caller.identity if caller.peer is None else caller.peer.kernel


def sent(answer: Answer) -> bytes:
    """The answer as one frame."""
    return replace(answer, protocol=versions.SPOKEN).to_bytes()


def refusal(what: str, caller: Caller, error: WiringError) -> bytes:
    """The answer that says why it is refused."""
    _LOG.warning("W-LINK: refused %s of %s: %s", what, name_of(caller), error)
    return sent(Answer(refused=str(error)))


def check_theirs(path: Path, caller: Caller) -> None:
    """WiringError: the port is not one of the kernel that asks."""
    if caller.peer is None or path.kernel != caller.peer.kernel:
        raise WiringError(f"{path}: is no port of {name_of(caller)}, which asks")


def is_end(port: Port[Any], found: Port[Any]) -> bool:
    """Whether this port of a connector is this one that was found, or stands for it."""
    return port is found or (found.elsewhere is not None and getattr(port, "far", None) == found.elsewhere)


class NamedEnds:
    """Reader's ends by a name of two parts. Each has one name, the last that it was given; so has each name."""

    def __init__(self) -> None:
        self._links: dict[Name, ReaderLink] = {}
        self._names: dict[Link, Name] = {}

    def get(self, name: Name) -> ReaderLink | None:
        """The end of this name."""
        return self._links.get(name)

    def name_of(self, link: ReaderLink) -> Name | None:
        """The name of this end."""
        return self._names.get(link)

    def put(self, name: Name, link: ReaderLink) -> None:
        """Give an end a name."""
        self.forget(link)
        if (before := self._links.get(name)) is not None:
            del self._names[before]
        self._links[name], self._names[link] = link, name

    def forget(self, link: Link) -> None:
        """It has no name any more."""
        if (name := self._names.pop(link, None)) is not None:  # a writer's end has none
            del self._links[name]


class EndsByComponent:
    """Links by the component at their other end, whatever kernel that is in."""

    def __init__(self) -> None:
        self._links: dict[str, dict[Link, None]] = {}

    def add(self, far: Path, link: Link) -> None:
        """There is a link; `far`: the port at its other end."""
        self._links.setdefault(far.component, {})[link] = None

    def remove(self, far: Path, link: Link) -> None:
        """It has ended."""
        links = self._links[far.component]
        del links[link]
        if not links:
            del self._links[far.component]

    def at(self, component: str) -> Collection[Link]:
        """Those to a component of this name, in the order in which they were added."""
        return tuple(self._links.get(component, ()))
