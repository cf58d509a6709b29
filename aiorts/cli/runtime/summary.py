"""`aiorts run --json`: one JSON document at the end of a run, of what it was and how it ended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts import KernelService
from aiorts.errors import AiortsError, format_error
from aiorts.system import ended_in_error

if TYPE_CHECKING:
    from aiorts import Kernel
    from aiorts.cli.runtime.session import Construct
    from aiorts.kernel.loop.deadlines import StopBudget


class Summary:
    """The outcome of a run as JSON: status, errors and profile; the error alone of a run that never began."""

    def __init__(self) -> None:
        self._found: dict[str, Any] = {"errors": {}, "profile": None}

    def refused(self, error: AiortsError) -> None:
        """Nothing was run."""
        self._found["error"] = {"code": error.code, "text": str(error)}

    def of(self, make: Construct) -> Construct:
        """Makes the system of `make`, and takes its profile when it ends."""

        async def both(kernel: Kernel) -> None:
            kernel.service(_Look).found = self._found
            await make(kernel)

        return both

    def document(self, status: int) -> dict[str, Any]:
        """The exit status, the errors of components by name, and the profile of the kernel when its contexts ended."""
        return {"status": status, **self._found}


class _Look(KernelService):
    """Looks at the kernel before it stops, and at its connectors once everything has."""

    found: dict[str, Any]

    async def closing(self, budget: StopBudget) -> None:
        kernel: Any = self.kernel
        failed = ended_in_error(kernel)
        self.found["errors"] = {name: "" if error is None else format_error(error) for name, error in failed.items()}
        self.found["profile"] = kernel.profile().to_plain()

    async def ending(self, budget: StopBudget) -> None:
        kernel: Any = self.kernel
        last = kernel.profile().to_plain()
        self.found["profile"]["connectors"] = last["connectors"]
