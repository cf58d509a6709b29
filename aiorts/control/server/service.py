"""The service through which clients of the same user look into a kernel and control it, over a local socket."""

from __future__ import annotations

import os
import platform
import re
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from aiorts.control.operation import Right
from aiorts.control.server.listener import Listener
from aiorts.control.session import LOG
from aiorts.errors import ConfigurationError, ControlError
from aiorts.kernel.execution.file_access import FileAccess
from aiorts.kernel.service import KernelService, check_settings, setting
from aiorts.late import dataclass
from aiorts.model.names import check_name
from aiorts.sessions import Claim, TakenError, is_supported

if TYPE_CHECKING:
    from aiorts.kernel.loop.deadlines import StopBudget
    from aiorts.kernel.microkernel import Microkernel

_RIGHTS: Final = {"on": Right.CODE, "view": Right.VIEW}
_UNNAMED: Final = re.compile(r"[^A-Za-z0-9_-]+")
_JOIN_SECONDS: Final = 1.0


@dataclass(frozen=True, slots=True)
class ControlSettings:
    """The settings by which clients of this user reach the kernel: what they may do, and its name."""

    mode: Literal["on", "view", "off"] = setting(
        "on", "What other terminals of this user may do with the run: all (on), look (view), nothing (off).", option=""
    )
    name: str = setting("", "The name by which other terminals reach the run; PROGRAM-PID by default.", option="--name")
    program: str = setting("", "What its name begins with where it has none.")
    runs: str = setting("", "What it runs, by which it is known again where it has no name: the path of its file.")
    files: Path | None = setting(
        None,
        "The folder below which clients that lack the right 'code' may name files; none by default.",
        option="--files",
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.files is not None and not (str(self.files) and self.files.is_dir()):
            raise ConfigurationError(f"files: {str(self.files)!r:.80}: there is no such folder")
        if self.name:
            try:
                check_name(self.name, "kernel")
            except ValueError as error:
                raise ConfigurationError(f"name: {error}") from None


class Control(KernelService):
    """The service that opens the socket of a kernel and serves it: see `aiorts help look-into`."""

    name = "control"
    settings = ControlSettings

    def __init__(self, kernel: Microkernel) -> None:
        super().__init__(kernel)
        self.files: Path | None = None
        """The folder below which clients may name files."""
        self._claim: Claim | None = None
        self._listener: Listener | None = None

    def configure(self, settings: ControlSettings) -> None:
        self._close()
        if settings.mode == "off" or not (settings.name or is_supported()):
            return
        host = _fit(platform.node()) or "host"
        program = _fit(settings.program or _program(self.kernel.name))
        name = settings.name or f"{program}-{os.getpid()}"
        address, epoch = f"{host}/{name}", int.from_bytes(os.urandom(8), "big")
        try:
            self._claim = _claim(address, f"{epoch:016x}", named=bool(settings.name))
        except (ControlError, OSError) as error:
            if isinstance(error, TakenError):
                raise
            LOG.warning("other terminals cannot look into this run: %s", error)
            return
        number = self._claim.entry.address.removeprefix(address)  # "-2", ... for several unnamed kernels of one process
        lasting = settings.name or f"{program}{number}:{settings.runs or _file()}"
        self.kernel.registry.lasting, self.kernel.registry.runs = f"{host}/{lasting}", settings.runs
        address = self._claim.entry.address
        right = _RIGHTS[settings.mode]
        hello = {
            "address": address,
            "epoch": self._claim.entry.epoch,
            "kernel": self.kernel.name,
            "lasting": self.kernel.registry.lasting,
            "pid": os.getpid(),
            "right": right.value,
        }
        self.kernel.address, self.kernel.epoch = address, epoch
        self.files = None if settings.files is None else settings.files.resolve()
        files = FileAccess(self.files)
        self._listener = Listener(self.kernel, self._claim, right, hello, files)

    def admit(self, right: Right, where: str) -> socket.socket:
        """Admit a client: see `Listener.admit`. ControlError: clients cannot look into this kernel, or it ends."""
        listener = self._listener
        if listener is None:
            raise ControlError(f"{self.kernel.name}: cannot be looked into")
        return listener.admit(right, where)

    @property
    def hello(self) -> Mapping[str, Any]:
        """The kernel's hello to clients; empty where clients cannot look into the kernel."""
        return {} if self._listener is None else self._listener.hello

    async def ending(self, budget: StopBudget) -> None:
        if self._listener is not None:
            self._listener.end_sessions()

    def closed(self) -> None:
        self._close()

    def _close(self) -> None:
        if self._claim is not None:
            self._claim.withdraw()
        if self._listener is not None:
            self._listener.close(_JOIN_SECONDS)
        if self._claim is not None:
            self._claim.listener.close()
        self._claim = self._listener = None
        self.kernel.address, self.kernel.epoch = "", 0
        self.kernel.registry.lasting = self.kernel.registry.runs = ""


def _claim(address: str, epoch: str, *, named: bool) -> Claim:
    """Claim the entry; a kernel without a name of its own takes the next number that is free."""
    for number in range(2, 1000):
        try:
            return Claim(address if number == 2 else f"{address}-{number}", epoch)
        except TakenError:
            if named:
                raise
    raise ControlError(f"{address}: a thousand kernels of this process have it")


def _program(kernel: str) -> str:
    """The name of the program, from which the kernel's name is made."""
    return kernel if kernel != "kernel" else Path(sys.argv[0] if sys.argv else "").stem or "python"


def _file() -> str:
    """The path of the script that the process runs; "" where it runs none."""
    return os.path.realpath(sys.argv[0]) if sys.argv and os.path.isfile(sys.argv[0]) else ""


def _fit(text: str) -> str:
    """The text made fit for a name."""
    return _UNNAMED.sub("-", text).strip("-")[:40]
