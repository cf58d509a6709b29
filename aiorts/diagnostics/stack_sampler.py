"""Samples what a thread runs right now, and the kernel's times of hooks; it keeps no frame.

Called while a context is late, from the monitor thread: everything read here may change meanwhile, and parts that
cannot be read are left out.
"""

from __future__ import annotations

import asyncio
import sys
from typing import TYPE_CHECKING, Any, Final

from aiorts.diagnostics.blame import Entry, Glance, Line, choose_line, cut_at_loop
from aiorts.kernel.loop.tasks import current_task, owner_of
from aiorts.model.blame import Blame

if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import CodeType, FrameType

    from aiorts.kernel.execution.context import Context
    from aiorts.kernel.execution.member import Member
    from aiorts.kernel.microkernel import Microkernel

_DEEPEST: Final = 2000
"""Frames of a stack that are read."""


def look(kernel: Microkernel, context: Context, thread_id: int, base: int, at_ns: int) -> Glance:
    """Sample the thread that should run `context`; the caller fills in `absent_ns`."""
    lines = _stack(thread_id)
    on_loop = thread_id == kernel.thread_id
    waits = _waiting(context) if on_loop else None
    if not on_loop:
        member = _current(context)
        if member is None:
            return Glance(at_ns, None)
        return Glance(at_ns, _blame_hook(member, lines, "hook", "its thread"), None, 0, _entry(member, member.hook))
    task = asyncio.current_task(kernel.loop)
    driver = getattr(task, "_aiorts_driver", None)
    if driver is not None:
        member = driver.current
        if member is None:
            return Glance(at_ns, None, waits)
        kind = "hook" if member.context is context else "loop"
        took = _entry(member, member.hook, own=kind == "hook")
        return Glance(at_ns, _blame_hook(member, lines, kind, "the loop"), waits, 0, took)
    called = cut_at_loop(lines, base)
    line = choose_line(called, None)
    if line is None:
        return Glance(at_ns, None, waits)
    component = owner_of(task)
    name = "" if component is None else component.name
    return Glance(at_ns, Blame("loop", name, "", line.file, line.line, line.function), waits)


def books(kernel: Microkernel, context: Context, *, whole: bool) -> Iterator[tuple[Member, Entry]]:
    """The hooks whose times the kernel has: those of the context, and if `whole` of the others on its loop."""
    contexts = tuple(kernel.contexts.values()) if whole and not context.exclusive else (context,)
    for one in contexts:
        if one is not context and one.exclusive:
            continue
        for member in tuple(one.runner.members):
            for hook in tuple(member.times):
                yield member, _entry(member, hook, own=one is context)


def depth_beneath_task() -> int:
    """The number of frames beneath the running task: the event loop and its callers."""
    coroutine: Any = None if (task := current_task()) is None else task.get_coro()
    outermost = getattr(coroutine, "cr_frame", None)
    frame: FrameType | None = None if outermost is None else outermost.f_back
    depth = 0
    while frame is not None and depth < _DEEPEST:
        frame, depth = frame.f_back, depth + 1
    return depth


def _stack(thread_id: int) -> list[Line]:
    """The frames of a thread, innermost first."""
    frame = sys._current_frames().get(thread_id)
    lines: list[Line] = []
    while frame is not None and len(lines) < _DEEPEST:
        lines.append(_line(frame))
        frame = frame.f_back
    return lines


def _line(frame: FrameType) -> Line:
    code = frame.f_code
    return Line(code.co_filename, frame.f_lineno or code.co_firstlineno, code.co_name, code.co_firstlineno)


def _current(context: Context) -> Member | None:
    """The member whose hook runs or waits now."""
    return _busy(context).current if context.running else None


def _busy(context: Context) -> Any:
    """The driver that carries out a hook now: the context's own, or the first lane that does."""
    driver: Any = context.runner.driver
    return next((lane for lane in getattr(driver, "helpers", ()) if lane.current is not None), driver)


def _waiting(context: Context) -> Blame | None:
    """The context's own hook, at the line where it waits."""
    member = _current(context)
    task: Any = getattr(_busy(context), "task", None)
    if member is None or task is None:
        return None
    lines: list[Line] = []
    # From the driver's coroutine inwards, as far as what is awaited has frames.
    awaited: Any = task.get_coro()
    while awaited is not None and len(lines) < _DEEPEST:
        frame = getattr(awaited, "cr_frame", None) or getattr(awaited, "gi_frame", None)
        if frame is not None:
            lines.insert(0, _line(frame))
        awaited = getattr(awaited, "cr_await", None) or getattr(awaited, "gi_yieldfrom", None)
    return _blame_hook(member, lines, "hook", "its context")


def _definition(member: Member, hook: str) -> Line | None:
    function: Any = member.hooks[hook][1]
    code: CodeType | None = getattr(function, "__code__", None)
    if code is None:
        return None
    return Line(code.co_filename, code.co_firstlineno, code.co_name, code.co_firstlineno)


def _blame_hook(member: Member, lines: list[Line], kind: str, held: str) -> Blame:
    hook = member.hook
    if hook not in member.hooks:  # over while it was looked at
        return Blame(kind, member.component.name, hook, held=held)
    line = choose_line(lines, _definition(member, hook)) or Line("", 0, "")
    return Blame(kind, member.component.name, hook, line.file, line.line, line.function, held=held)


def _entry(member: Member, hook: str, *, own: bool = True) -> Entry:
    times = member.times.get(hook)
    line = _definition(member, hook) if hook in member.hooks else None
    file, first, function = ("", 0, "") if line is None else (line.file, line.line, line.function)
    held = "its thread" if member.context.exclusive else "its context" if own else "the loop"
    blame = Blame("hook" if own else "loop", member.component.name, hook, file, first, function, held=held)
    if times is None:
        return Entry(blame, 0, 0, own, 0, id(member))
    return Entry(blame, times.last_ns, times.count, own, times.max_ns, id(member))
