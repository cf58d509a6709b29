"""Components that the kernel's tests share: one that remembers its hooks, one that fails in a hook of your choice."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts import Component
from aiorts.model.lifecycle import HOOKS

if TYPE_CHECKING:
    from collections.abc import Callable

TAKES_ERROR = ("on_error", "on_aborting")


class Diary(Component):
    """Notes every hook that runs, and what `on_error` and `on_aborting` are told."""

    def __init__(self, name: str = "") -> None:
        super().__init__(name)
        self.ran: list[str] = []
        self.told: list[tuple[str, BaseException]] = []
        self.plan: dict[str, Callable[[], Any]] = {}

    def count(self, hook: str) -> int:
        return self.ran.count(hook)

    def note(self, hook: str, *error: BaseException) -> None:
        self.ran.append(hook)
        if error:
            self.told.append((hook, error[0]))
        if hook in self.plan:
            self.plan[hook]()


def _plain(hook: str) -> Any:
    if hook in TAKES_ERROR:
        return lambda self, error: self.note(hook, error)
    return lambda self: self.note(hook)


def _awaited(hook: str) -> Any:
    if hook in TAKES_ERROR:

        async def told(self: Diary, error: BaseException) -> None:
            self.note(hook, error)

        return told

    async def run(self: Diary) -> None:
        self.note(hook)

    return run


PlainDiary = type("PlainDiary", (Diary,), {hook: _plain(hook) for hook in HOOKS})
AsyncDiary = type("AsyncDiary", (Diary,), {hook: _awaited(hook) for hook in HOOKS})


def raising(error: BaseException) -> Callable[[], None]:
    """A plan that raises this very error."""

    def raise_it() -> None:
        raise error

    return raise_it
