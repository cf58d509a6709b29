"""Exceptions and logging handlers of an application that raise themselves when they are touched, many kinds of each."""

from __future__ import annotations

import asyncio
import logging
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator

BASES: tuple[type[BaseException], ...] = (
    Exception,
    BaseException,
    ValueError,
    OSError,
    AttributeError,
    SyntaxError,
    ImportError,
    TimeoutError,
    SystemExit,
    KeyboardInterrupt,
    asyncio.CancelledError,
    StopIteration,
    StopAsyncIteration,
)
"""All but GeneratorExit, which says that a loop is gone."""
RAISED: tuple[type[BaseException], ...] = (
    RuntimeError,
    ConnectionResetError,
    KeyError,
    SystemExit,
    KeyboardInterrupt,
    asyncio.CancelledError,
    RecursionError,
    MemoryError,
    StopIteration,
)
METHODS = (
    "__setattr__",
    "__delattr__",
    "__bool__",
    "__len__",
    "__str__",
    "__repr__",
    "__format__",
    "__eq__",
    "__hash__",
    "__iter__",
    "__reduce__",
    "with_traceback",
    "add_note",
)
PROPERTIES = (
    "__class__",
    "__cause__",
    "__context__",
    "__suppress_context__",
    "__traceback__",
    "__notes__",
    "__dict__",
    "args",
    "errno",
    "code",
    "typed",
)


class _Text(str):
    """Text that is no plain text."""

    def __len__(self) -> int:
        raise RuntimeError("the length of a text")

    def __bool__(self) -> bool:
        raise RuntimeError("the truth of a text")

    def __format__(self, form: str) -> str:
        raise RuntimeError("the form of a text")

    def encode(self, *args: Any, **options: Any) -> bytes:
        raise RuntimeError("the bytes of a text")


class _Named(type):
    @property
    def __name__(cls) -> str:  # type: ignore[override]
        raise RuntimeError("the name of a class")

    def __instancecheck__(cls, instance: object) -> bool:
        raise RuntimeError("an instance of a class")


@dataclass(frozen=True)
class Refused(Exception):
    """What many a program raises: nothing of it can be set."""

    code: int = 1


@dataclass(frozen=True, slots=True)
class RefusedInSlots(Exception):
    """The same, in slots."""

    code: int = 1


@dataclass
class Unhashable(Exception):
    """Compared by value, so it has no hash."""

    codes: Any = ()


def _raising(kind: type[BaseException], what: str) -> Callable[..., Any]:
    def method(*_args: Any, **_options: Any) -> Any:
        raise kind(f"hostile {what}")

    return method


def hostile(random: random.Random) -> BaseException:
    """An exception that raises at one or several touches."""
    ready: Any = random.randrange(12)
    if ready < 3:
        return (Refused, RefusedInSlots, Unhashable)[ready](random.randrange(9))
    if ready == 3:
        return ValueError(hostile(random), "beside it")
    base: Any = random.choice(BASES)
    names = random.sample(METHODS + PROPERTIES, random.choice((1, 1, 2, 5)))
    space: dict[str, Any] = {}
    for name in names:
        touched = _raising(random.choice(RAISED), name)
        space[name] = property(touched) if name in PROPERTIES else touched
    if random.random() < 0.1:
        space["__getattribute__"] = _raising(random.choice(RAISED), "attribute")
    if random.random() < 0.1:
        space["__str__"] = lambda _self: _Text("a text of its own")
    kind = (_Named if random.random() < 0.1 else type)("Hostile", (base,), space)
    if issubclass(base, SyntaxError):
        return kind("hostile")  # type: ignore[no-any-return]
    if random.random() < 0.2:
        return kind(hostile(random))  # type: ignore[no-any-return]
    return kind("hostile", 7)  # type: ignore[no-any-return]


@contextmanager
def hostile_logging(random: random.Random) -> Iterator[None]:
    """The application's logging raises for every line: a handler, what formats its lines, or a filter; or nothing."""
    kind = random.choice(RAISED)
    way = random.choice(("nothing", "emit", "handle", "filter", "format", "logger filter", "own kind"))
    told = _raising(kind, way)
    handler: Any = logging.NullHandler() if way in ("nothing", "logger filter") else logging.StreamHandler()
    root, component, kernel = map(logging.getLogger, (None, "aiorts.component", "aiorts.kernel"))
    if way == "own kind":
        error = hostile(random)

        def told(*_args: Any) -> Any:
            raise error

    if way in ("emit", "own kind"):
        handler.emit = told
    elif way == "handle":
        handler.handle = told
    elif way == "filter":
        handler.addFilter(told)
    elif way == "format":
        handler.setFormatter(type("Form", (logging.Formatter,), {"format": told})())
    elif way == "logger filter":
        component.addFilter(told)
        kernel.addFilter(told)
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)
        component.removeFilter(told)
        kernel.removeFilter(told)
