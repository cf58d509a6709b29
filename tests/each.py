"""One test for one rule that holds for each of many: it names all for which it does not, not the first alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def each(cases: Iterable[Any]) -> Callable[[Callable[[Any], None]], Callable[[], None]]:
    """Make one test of a check of one case.

    Parametrising instead makes a test of each case: thousands, which cost more to collect than to run.
    """
    cases = list(cases)
    assert cases, "a rule for nothing"

    def decorate(check: Callable[[Any], None]) -> Callable[[], None]:
        def test() -> None:
            offenders = {}
            for case in cases:
                try:
                    check(case)
                except Exception as error:
                    offenders[getattr(case, "__name__", str(case))] = error
            if offenders:
                listed = "\n".join(f"{name}: {type(error).__name__}: {error}" for name, error in offenders.items())
                pytest.fail(f"{len(offenders)} of {len(cases)}:\n{listed}", pytrace=False)

        test.__name__, test.__qualname__, test.__doc__ = check.__name__, check.__qualname__, check.__doc__
        test.__module__ = check.__module__
        return test

    return decorate
