"""Names new instances by a kernel's policy (`model/naming.py`), and knows the open kernels of the process."""

from __future__ import annotations

import os
import threading
import weakref
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from aiorts.kernel.execution.cell import Cell, ComponentSide, KernelSide
    from aiorts.model.naming import NamePolicy

_LOCK: Final = threading.Lock()
_OPEN: Final[weakref.WeakSet[KernelSide]] = weakref.WeakSet()


def opened(kernel: KernelSide) -> None:
    """Count the names of this kernel's instances in the process from now on."""
    with _LOCK:
        _OPEN.add(kernel)


def closed(kernel: KernelSide) -> None:
    """Free the names of this kernel's instances."""
    with _LOCK:
        _OPEN.discard(kernel)


def kept_cell(component: ComponentSide) -> Cell | None:
    """The cell of a component as its open kernel has it; None when the component belongs to none."""
    with _LOCK:
        kernels = tuple(_OPEN)
    return next(filter(None, (kernel.registry.kept_cell(component) for kernel in kernels)), None)


def instance_name(kernel: KernelSide, kind: type, policy: NamePolicy) -> str:
    """The name of the next instance of this type."""
    import platform  # 1.5 ms that few kernels need

    values = {"type": kind.__name__.lower(), "kernel": kernel.name, "host": platform.node(), "pid": os.getpid()}
    with _LOCK:
        kernels = tuple(_OPEN) if policy.scope == "process" else (kernel,)
    return policy.lowest(values, lambda name: any(name in one.components or name in one.contexts for one in kernels))
