"""`aiorts run --json`: one JSON document at the end of a run, with its profile and outcome."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from aiorts import KernelService
from aiorts.errors import AiortsError, ComponentError, format_error
from aiorts.system import ended_in_error

if TYPE_CHECKING:
    from aiorts import Kernel
    from aiorts.kernel.loop.deadlines import StopBudget


class Summary:
    """The outcome of a run as JSON: status, errors and profile; for a run that never began, its error."""

    def __init__(self) -> None:
        self._found: dict[str, Any] = {"errors": {}, "profile": None}

    def refused(self, error: BaseException) -> None:
        """Keep the error for which the run was refused."""
        code, text = ComponentError.code, format_error(error)
        if isinstance(error, AiortsError):
            code, text = error.code, str(error)
        self._found["error"] = {"code": code, "text": text}

    def prepare(self, kernel: Kernel) -> None:
        """Give the kernel a service that takes its profile when it ends."""
        kernel.service(_Look).found = self._found

    def document(self, status: int) -> dict[str, Any]:
        """The exit status, the errors of components by name, and the profile of the kernel when its contexts ended."""
        return {"status": status, **self._found}


class _Look(KernelService):
    """The service that takes the profile before the kernel stops, and its connectors again after all contexts."""

    found: dict[str, Any]

    async def closing(self, budget: StopBudget) -> None:
        kernel: Any = self.kernel
        failed = ended_in_error(kernel)
        self.found["errors"] = {name: "" if error is None else format_error(error) for name, error in failed.items()}
        self.found["profile"] = kernel.profile().to_plain()

    async def ending(self, budget: StopBudget) -> None:
        kernel: Any = self.kernel
        if (profile := self.found["profile"]) is not None:
            profile["connectors"] = kernel.profile().to_plain()["connectors"]
