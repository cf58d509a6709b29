"""What an operation of a kernel is: one row of the table that every carrier goes by."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import Any, Final

from aiorts.late import dataclass


class Right(Enum):
    """What a session may do; each includes those before it."""

    VIEW = "view"
    OPERATE = "operate"
    CODE = "code"

    def allows(self, right: Right) -> bool:
        """Whether who has this may do what needs `right`."""
        return _ORDER.index(right) <= _ORDER.index(self)


_ORDER: Final = tuple(Right)


@dataclass(frozen=True, slots=True)
class Operation:
    """One operation: what it takes and gives, and who may call it."""

    name: str
    text: str
    """What it does, in one line."""
    arguments: type[Any]
    """A frozen dataclass of what is in `args`."""
    result: Any
    """The type of the result; of an operation that streams, of what it says when it begins. A field of it that has a
    default may be missing in an answer."""
    right: Right
    run: Callable[..., Any]
    """Carries it out on the kernel's loop: `run(session, arguments)`, and the stream as a third where it streams.
    Returns the result, or an awaitable of it. What looks and changes nothing returns without waiting."""
    idempotent: bool = False
    """Whether calling it twice is as good as once."""
    item: Any = None
    """The type of the items of a stream; None of an operation that does not stream."""
    end: Any = None
    """The type of what a stream says at its end; None where it says nothing."""
    demands: Callable[[Any], Right] | None = None
    """The right that these very arguments need, where it is more than `right`."""
    changes: Callable[[Any, Any], Iterable[str]] | None = None
    """The components of which the client is the operator afterwards, by the arguments and the result; that is None as
    long as it is under way."""

    @property
    def streams(self) -> bool:
        """Whether it goes on with items after its result."""
        return self.item is not None

    def needed(self, arguments: Any) -> Right:
        """The right that a call with these arguments needs."""
        return self.right if self.demands is None else self.demands(arguments)


def is_code(type_name: str) -> bool:
    """Whether a type is read from a path, and not a name by which a plugin offers it."""
    return ":" in type_name or type_name.endswith(".py")


def converters_read(options: Mapping[str, Any]) -> list[str]:
    """The converters among the options of a connector that are read from a path."""
    every = {**options, **(options.get("openrtm") or {})}
    return [str(value) for key, value in every.items() if key.endswith("convert") and ":" in str(value)]


@dataclass(frozen=True, slots=True)
class Nothing:
    """No arguments."""
