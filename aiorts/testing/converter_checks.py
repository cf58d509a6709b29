"""The conformance suite of converters: their results have the right type, and they change and remember nothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import AiortsError
from aiorts.kernel.ports.port_types import port_type
from aiorts.late import dataclass
from aiorts.model.converter import function_fault
from aiorts.testing.conformance import Suite, expect
from aiorts.testing.samples import difference

if TYPE_CHECKING:
    from aiorts.model.converter import Function, Maker

_GARBAGE: Final = ("", " ", "\0", "=", "0>", "nonsense", "x" * 10_000, "1e999", "a=b c=d", "ä日\U0001f916")


@dataclass(frozen=True, slots=True)
class _Case:
    """A converter's maker, with a text and samples that it takes."""

    make: Maker
    text: str
    samples: Sequence[Any]
    target: type[Any]

    @property
    def source(self) -> type[Any]:
        return type(self.samples[0])

    def made(self) -> Function:
        return self.make(self.text, self.source, self.target)


_SUITE: Suite[_Case] = Suite()


def check_converter(
    make: Maker,
    text: str,
    samples: Sequence[Any],
    target: type[Any],
    *,
    only: Iterable[str] | None = None,
    skip: Iterable[str] = (),
) -> None:
    """Hold a converter of a plugin to the promises of its kind; `CONVERTER_CHECKS` lists them.

    Args:
        text: a text that it takes. samples: at least one, of one type, all of which it converts. target: the type of
            the in-port.
        only: names of the checks to run; by default all. skip: names of checks to leave out.

    Raises:
        ConformanceError: names the check that failed, expected and got.
        ValueError: there is no sample, or a check is unknown.
    """
    if not samples:
        raise ValueError("check_converter needs at least one sample that can be converted")
    name = getattr(make, "__qualname__", type(make).__qualname__)
    _SUITE.run(name, _Case(make, text, tuple(samples), target), only, skip)


@_SUITE.check
def makes_a_function(case: _Case) -> None:
    """Of the text and two types it makes a plain function of one sample."""
    fault = function_fault(case.made())
    expect(not fault, "a plain function of one sample", fault)


@_SUITE.check
def makes_what_the_port_takes(case: _Case) -> None:
    """Each sample becomes one of the in-port's type, as a write at a port of that type would take it."""
    function, kind = case.made(), port_type(case.target)
    for sample in case.samples:
        made = function(sample)
        expect(isinstance(made, case.target), f"a {case.target.__name__} of {sample!r}", made)
        kind.snapshot(made)


@_SUITE.check
def leaves_the_sample_as_it_is(case: _Case) -> None:
    """The sample, which other readers share, is the same afterwards."""
    function, kind = case.made(), port_type(case.source)
    for sample in case.samples:
        before = kind.copy(sample)
        function(sample)
        found = difference(kind.snapshot(sample), before)
        expect(found is None, f"{before!r} as it was", found)


@_SUITE.check
def remembers_nothing(case: _Case) -> None:
    """A sample becomes the same, whichever came before it, and at whichever connector."""
    first = case.made()
    alone = [case.made()(sample) for sample in case.samples]
    for _ in range(2):
        for sample, wanted in reversed(tuple(zip(case.samples, alone, strict=True))):
            found = difference(first(sample), wanted)
            expect(found is None, f"{wanted!r} of {sample!r} again", found)


@_SUITE.check
def refuses_a_text_with_an_error_of_aiorts(case: _Case) -> None:
    """A text that it does not take is refused by an AiortsError, which says why."""
    for text in _GARBAGE:
        try:
            case.make(text, case.source, case.target)
        except AiortsError as error:
            expect(bool(str(error)), f"a reason why {text[:20]!r} is refused", "an error without text")


CONVERTER_CHECKS: Final[Mapping[str, str]] = _SUITE.promises
"""The promise of each check of `check_converter`, by name, in the order of running."""
