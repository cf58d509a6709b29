"""An operation of a kernel: one row of the table that every carrier uses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import Any, Final

from aiorts.late import dataclass


class Right(Enum):
    """The rights of a session; each includes those before it."""

    VIEW = "view"
    OPERATE = "operate"
    CODE = "code"

    def allows(self, right: Right) -> bool:
        """Whether this right includes `right`."""
        return _ORDER.index(right) <= _ORDER.index(self)


_ORDER: Final = tuple(Right)


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation: its arguments, its result, and the right that it needs."""

    name: str
    text: str
    """The description of the operation, in one line."""
    arguments: type[Any]
    """The frozen dataclass of `args`."""
    result: Any
    """The type of the result; of an operation that streams, of its first answer. An answer may lack a field that has a
    default."""
    right: Right
    run: Callable[..., Any]
    """The function that carries the operation out on the kernel's loop: `run(session, arguments)`, with the stream as
    third argument where it streams. It returns the result or an awaitable of it; an operation that only looks does not
    wait."""
    idempotent: bool = False
    """Whether two calls have the same effect as one."""
    item: Any = None
    """The type of the items of a stream; None of an operation that does not stream."""
    end: Any = None
    """The type of the last answer of a stream; None where it has no value."""
    demands: Callable[[Any], Right] | None = None
    """The function that gives the right for the arguments of a call; None: it is always `right`."""
    changes: Callable[[Any, Any], Iterable[str]] | None = None
    """The function that returns the components that a call changes, from its arguments and result: the client becomes
    their operator. The result is None while the call runs."""

    @property
    def streams(self) -> bool:
        """Whether the operation sends items after its first answer."""
        return self.item is not None

    def needed(self, arguments: Any) -> Right:
        """The right that a call with these arguments needs."""
        return self.right if self.demands is None else self.demands(arguments)


def is_code(type_name: str) -> bool:
    """Whether the text for a type is the path of its code, not a name that a plugin offers."""
    return ":" in type_name or type_name.endswith(".py")


def converters_read(options: Mapping[str, Any]) -> list[str]:
    """The converters among the options of a connector that are read from a path."""
    every = {**options, **(options.get("openrtm") or {})}
    return [str(value) for key, value in every.items() if key.endswith("convert") and ":" in str(value)]


@dataclass(frozen=True, slots=True)
class Nothing:
    """No arguments."""
