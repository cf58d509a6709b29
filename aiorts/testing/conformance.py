"""The common part of all conformance suites: named checks, each a promise, and the error that names a broken one.

A suite is a table of checks, run in order; the first that fails ends it. A check that ends in any exception has failed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Generic, TypeVar

from aiorts.errors import AiortsError

S = TypeVar("S")


class ConformanceError(AiortsError, AssertionError):
    """The subject of a check does not keep a promise of its kind.

    Attributes:
        subject: the name of what was checked. check: the name of the check. expected, got: in words.
    """

    code: ClassVar[str] = "E-CONFORM"

    def __init__(self, subject: str, check: str, expected: str, got: str) -> None:
        super().__init__(f"{subject}: check {check}: expected {expected}; got {got}")
        self.subject = subject
        self.check = check
        self.expected = expected
        self.got = got


class _Unmet(AssertionError):
    """The failure that a check raises, to which `Suite.run` adds the subject."""

    def __init__(self, expected: str, got: object) -> None:
        super().__init__(expected, got)
        self.expected = expected
        self.got = got if isinstance(got, str) else repr(got)


def expect(met: bool, expected: str, got: object) -> None:
    """End the check as failed unless `met`; both texts complete "expected ...; got ..."."""
    if not met:
        raise _Unmet(expected, got)


class Suite(Generic[S]):
    """Checks by name; each is a function of the subject, and the first line of its docstring is the promise."""

    def __init__(self) -> None:
        self._checks: dict[str, Callable[[S], Any]] = {}

    def check(self, function: Callable[[S], Any]) -> Callable[[S], Any]:
        """Add a check, named as the function is."""
        self._checks[function.__name__] = function
        return function

    @property
    def promises(self) -> Mapping[str, str]:
        """The promise of each check, by name, in the order of running."""
        return MappingProxyType({name: _promise(function) for name, function in self._checks.items()})

    def run(self, subject: str, what: S, only: Iterable[str] | None, skip: Iterable[str]) -> None:
        """Run all checks, or `only` those named, but none in `skip`.

        Raises:
            ConformanceError: the first check that failed.
            ValueError: a name is not that of a check.
        """
        chosen, left_out = None if only is None else set(only), set(skip)
        unknown = (left_out | (chosen or set())) - self._checks.keys()
        if unknown:
            raise ValueError(f"no such check: {', '.join(sorted(unknown))}; there are {', '.join(self._checks)}")
        for name, function in self._checks.items():
            if name not in left_out and (chosen is None or name in chosen):
                try:
                    function(what)
                except _Unmet as error:
                    raise ConformanceError(subject, name, error.expected, error.got) from None
                except Exception as error:
                    got = f"{type(error).__name__}: {error}"
                    raise ConformanceError(subject, name, _promise(function), got) from error


def _promise(function: Callable[..., Any]) -> str:
    return (function.__doc__ or function.__name__).strip().splitlines()[0].rstrip(".")
