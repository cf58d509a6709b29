"""The operation that lists the types of components and kinds of contexts that can be created in a kernel."""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import field, replace
from typing import Any, Final, TypeVar

from aiorts.control.operation import Operation, Right
from aiorts.control.operations.known import absent
from aiorts.control.session import Session
from aiorts.errors import AiortsError
from aiorts.kernel.component import Component
from aiorts.kernel.execution.context import Context
from aiorts.kernel.extensions.arguments import arguments_of
from aiorts.kernel.extensions.catalogue import Extension
from aiorts.kernel.extensions.loading import is_imported, load_object_aside
from aiorts.late import dataclass
from aiorts.model.plain import empty
from aiorts.model.profile import PortProfile
from aiorts.model.values import WORDS
from aiorts.observe import ParameterReport, declaration_of, declared_params

T = TypeVar("T", "ComponentType", "ContextKind")
B = TypeVar("B")
_LONGEST: Final = 2_000
_UNKNOWN: Final = "is not imported yet"


@dataclass(frozen=True, slots=True)
class Described:
    """Types and kinds to import so that they are described; without any, nothing is imported."""

    components: tuple[str, ...] = ()
    contexts: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ComponentType:
    """A type of component that `create` takes by its name."""

    source: str
    """The source that offers the type: "package NAME VERSION", "folder PATH" or "file PATH"."""
    target: str
    """"module:Class"; of a single file "FILE.py:Class"."""
    unknown: str = ""
    """The reason why the fields below are unknown, such as a class not imported yet; "" where they are known."""
    doc: str = ""
    """The docstring of the class, at most 2,000 characters of it."""
    ports: tuple[PortProfile, ...] = ()
    """The ports that the class declares; a component may add others when it is created."""
    params: Mapping[str, ParameterReport] = field(default_factory=empty)
    """The parameters, each with its default as the value."""


@dataclass(frozen=True, slots=True)
class ContextKind:
    """A kind of context that `start_context` takes by its name."""

    source: str
    """As `ComponentType.source`."""
    target: str
    unknown: str = ""
    """As `ComponentType.unknown`."""
    doc: str = ""
    options: Mapping[str, tuple[str, ...]] = field(default_factory=empty)
    """The keyword arguments of the kind, by name: the types of value in words; an empty tuple is any type."""


@dataclass(frozen=True, slots=True)
class Offered:
    """The types and kinds that packages and folders offer a kernel, by name."""

    components: Mapping[str, ComponentType]
    contexts: Mapping[str, ContextKind]


def _catalogue(session: Session, given: Described) -> Offered | Awaitable[Offered]:
    """Describe all types and kinds that are imported; first import the named ones, in another thread."""
    offers = session.kernel.plugins
    named: list[Extension] = []
    for names, kind, what in (
        (given.components, "components", "type of component"),
        (given.contexts, "contexts", "kind of context"),
    ):
        known = offers.extensions(kind)
        for name in names:
            if name not in known:
                raise absent(f"{name:.80}: no such {what}", name, known)
            named.append(known[name][0])
    return _described(session, named) if named else _offered(session, {})


async def _described(session: Session, named: Sequence[Extension]) -> Offered:
    faults = {}
    for one in named:
        try:
            await load_object_aside(one, session.kernel.clock)
        except AiortsError as error:
            faults[one] = str(error)
    return _offered(session, faults)


def _offered(session: Session, faults: Mapping[Extension, str]) -> Offered:
    offers = session.kernel.plugins

    def described(made: T, offer: Extension, base: type[B], more: Callable[[type[B]], Mapping[str, Any]]) -> T:
        if not is_imported(offer):
            return replace(made, unknown=faults.get(offer, _UNKNOWN))
        try:
            cls = offers.find(offer.kind, offer.name).load_class(base)  # raises where several plugins offer it
        except AiortsError as error:
            return replace(made, unknown=str(error))
        doc = (inspect.getdoc(cls) or "")[:_LONGEST] if cls.__doc__ else ""
        return replace(made, doc=doc, **more(cls))

    return Offered(
        {
            name: described(ComponentType(one.source, one.target), one, Component, _of_component)
            for name, (one, *_) in offers.extensions("components").items()
        },
        {
            name: described(ContextKind(one.source, one.target), one, Context, _of_context)
            for name, (one, *_) in offers.extensions("contexts").items()
        },
    )


def _of_component(cls: type[Component]) -> dict[str, Any]:
    return {"ports": declaration_of(cls).ports, "params": declared_params(cls)}


def _of_context(cls: type[Context]) -> dict[str, Any]:
    return {"options": {name: tuple(WORDS[kind] for kind in kinds) for name, kinds in arguments_of(cls).items()}}


def _needed(given: Described) -> Right:
    """The needed right: importing runs the code of a package, so the right "view" is not enough for it."""
    return Right.OPERATE if given.components or given.contexts else Right.VIEW


ROWS: Final = (
    Operation(
        "catalogue",
        "What can be created: types of components and kinds of contexts, with what they take.",
        Described,
        Offered,
        Right.VIEW,
        _catalogue,
        idempotent=True,
        demands=_needed,
    ),
)
