"""Converters that break one promise each; the conformance suite must find every one of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from aiorts.errors import ConfigurationError
from aiorts.types import TimedDouble, TimedLong


def right(text: str, source: type[Any], target: type[Any]) -> Callable[[Any], Any]:
    """Keeps all promises."""
    try:
        factor = float(text)
    except ValueError:
        raise ConfigurationError(f"{text[:40]!r} is no number") from None
    return lambda sample: TimedDouble(sample.tm, sample.data * factor)


def _is_two(text: str, source: type[Any], target: type[Any]) -> Any:
    return lambda one, two: one


def _is_a_coroutine(text: str, source: type[Any], target: type[Any]) -> Any:
    async def convert(sample: Any) -> Any:
        return sample

    return convert


def _remembers(text: str, source: type[Any], target: type[Any]) -> Any:
    total = 0.0

    def add(sample: TimedDouble) -> TimedDouble:
        nonlocal total
        total += sample.data
        return TimedDouble(sample.tm, total)

    return add


def _changes(text: str, source: type[Any], target: type[Any]) -> Any:
    def change(sample: TimedDouble) -> TimedDouble:
        object.__setattr__(sample, "data", sample.data + 1)
        return TimedDouble(0, 1.0)

    return change


def _lets_errors_through(text: str, source: type[Any], target: type[Any]) -> Any:
    factor = float(text)
    return lambda sample: TimedDouble(sample.tm, sample.data * factor)


WRONG: Final[dict[str, tuple[Any, type[Any], str]]] = {
    "takes two": (_is_two, TimedDouble, "makes_a_function"),
    "is a coroutine function": (_is_a_coroutine, TimedDouble, "makes_a_function"),
    "makes another type": (right, TimedLong, "makes_what_the_port_takes"),
    "changes the sample": (_changes, TimedDouble, "leaves_the_sample_as_it_is"),
    "remembers": (_remembers, TimedDouble, "remembers_nothing"),
    "lets errors through": (_lets_errors_through, TimedDouble, "refuses_a_text_with_an_error_of_aiorts"),
}
