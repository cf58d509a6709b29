"""`aiorts.run(main)` for scripts: the fastest loop there is, as `asyncio.run` otherwise. It changes no policy."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")


def run(
    main: Callable[[], Coroutine[Any, Any, T]] | Coroutine[Any, Any, T],
    *,
    loop: str = "auto",
    debug: bool | None = None,
) -> T:
    """Run `main` (a coroutine function or a coroutine) on a loop of its own and return what it returns.

    Args:
        loop: "auto" is uvloop where it is installed, else asyncio; "uvloop" or "asyncio" asks for one.

    Raises:
        ValueError: another word for `loop`.
        ImportError: uvloop was asked for and is not there.
    """
    with asyncio.Runner(debug=debug, loop_factory=loop_factory(loop)) as runner:
        return runner.run(main() if callable(main) else main)


def loop_factory(loop: str) -> Callable[[], asyncio.AbstractEventLoop] | None:
    """What makes the loop of that name; None is asyncio's own."""
    if loop not in ("auto", "uvloop", "asyncio"):
        raise ValueError(f'loop = {loop!r}: expected "auto", "uvloop" or "asyncio"')
    if loop == "asyncio":
        return None
    try:
        import uvloop
    except ImportError:
        if loop == "uvloop":
            raise
        return None
    factory: Callable[[], asyncio.AbstractEventLoop] = uvloop.new_event_loop
    return factory
