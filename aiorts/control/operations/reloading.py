"""The operation that replaces the code of components."""

from __future__ import annotations

from typing import Any, Final

from aiorts.control.operation import Operation, Right
from aiorts.control.session import Session
from aiorts.errors import ControlError
from aiorts.late import dataclass
from aiorts.reload import Reloaded


@dataclass(frozen=True, slots=True)
class Reload:
    """The component or type whose code is read again."""

    type: str
    """The name of a component, or a type as `Kernel.reload` takes it as text."""
    cycles: int = 10
    """Cycles of each context after which the new code counts as proved; `seconds` may be over before."""
    seconds: float = 1.0
    """Seconds of the kernel's clock after which the new code counts as proved; `cycles` may be over before."""
    timeout: float | None = 5.0
    """Seconds of the kernel's clock in which each new instance has to be in place; None: no limit."""
    window: float = 0.0
    """Seconds of the kernel's clock for which the old and the new code are measured; the new must not do worse."""


async def _reload(session: Session, given: Reload) -> Reloaded:
    from aiorts.reload import reload  # late: most systems never do

    kernel = session.kernel
    kernel.check_open("reload")
    component = kernel.components.get(given.type)
    kind: Any = given.type if component is None else type(component)
    if not kind:
        raise ControlError("reload: say a component or a type")
    return await reload(
        kernel,
        kind,
        cycles=given.cycles,
        seconds=given.seconds,
        timeout=given.timeout,
        import_timeout=30.0,
        window=given.window,
    )


ROWS: Final = (Operation("reload", "Replace the code of components.", Reload, Reloaded, Right.CODE, _reload),)
