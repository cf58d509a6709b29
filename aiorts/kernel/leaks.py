"""The threads, open files, sockets and processes that a finalised component still has; nothing is ended.

Python does not note which code started a thread or opened a file. Found is what the component refers to: its
attributes, the items of a list, tuple, set or dict among them, and threads that run one of its methods.
"""

from __future__ import annotations

import functools
import io
import socket
import subprocess
import sys
import threading
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any, TypeGuard

from aiorts.kernel.execution.cell import ATTRIBUTE
from aiorts.kernel.loop.guarded import KernelLog

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

    from aiorts.kernel.execution.cell import ComponentSide


_LOG = KernelLog()


def report_leaks(component: ComponentSide, passed_on: Collection[object] = ()) -> None:
    """Log what a finalised component still has, if there is anything."""
    if left := leftovers(component, passed_on):
        _LOG.warning("%s: left after on_finalize: %s", component.name, ", ".join(left))


def leftovers(component: ComponentSide, passed_on: Collection[object] = ()) -> list[str]:
    """A text for each thing left, such as "thread 'reader' (self.reader)"; without what was `passed_on` to another."""
    found: dict[int, str] = {}
    others = frozenset(map(id, passed_on))
    for name, value in tuple(vars(component).items()):
        if name == ATTRIBUTE or id(value) in others:
            continue
        for one in _inside(value):
            for thing, text in _named(one):
                found.setdefault(id(thing), f"{text} (self.{name})")
    for thread in threading.enumerate():
        if id(thread) not in found and _whose(getattr(thread, "_target", None)) is component:
            found[id(thread)] = f"thread {thread.name!r}"
    return list(found.values())


def _inside(value: object) -> Iterator[object]:
    # By the exact type: a derived class may do anything when it is iterated.
    if type(value) in (list, tuple, set, frozenset):
        yield from tuple(value)  # type: ignore[arg-type] # one of the four
    elif type(value) is dict:
        yield from tuple(value.values())
    else:
        yield value


def _named(one: object) -> Iterator[tuple[object, str]]:
    """Each thing in `one` that is alive or open, with a text: `one` itself, or the threads of a pool."""
    if isinstance(one, threading.Thread):
        if one.is_alive():
            yield one, f"thread {one.name!r}"
    elif _is_pool(one):
        for thread in tuple(one._threads):
            if thread.is_alive():
                yield thread, f"thread {thread.name!r}"
    elif isinstance(one, socket.socket):
        if one.fileno() >= 0:
            yield one, f"socket of descriptor {one.fileno()}"
    elif isinstance(one, subprocess.Popen):
        if one.returncode is None:
            yield one, f"process {one.pid}"
    elif isinstance(one, io.IOBase) and not isinstance(one, io.BytesIO | io.StringIO) and not one.closed:
        yield one, f"file {_path(one)!r}"


def _is_pool(one: Any) -> TypeGuard[ThreadPoolExecutor]:
    loaded = sys.modules.get("concurrent.futures.thread")  # where it is not loaded there is none
    return loaded is not None and isinstance(one, loaded.ThreadPoolExecutor)


def _path(file: io.IOBase) -> object:
    return getattr(file, "name", type(file).__name__)


def _whose(target: Any) -> object:
    while isinstance(target, functools.partial):
        target = target.func
    return getattr(target, "__self__", None)
