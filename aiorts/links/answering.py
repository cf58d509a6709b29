"""Answers to what other kernels ask about links: with the versions that this kernel speaks; a refusal is logged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import WiringError
from aiorts.kernel.loop.guarded import KernelLog
from aiorts.links import versions
from aiorts.links.messages import Answer

if TYPE_CHECKING:
    from aiorts.kernel.ports import Port
    from aiorts.links.transport import Caller
    from aiorts.model.names import Path

_LOG: Final = KernelLog()


def name_of(caller: Caller) -> str:
    """Of who asks, as the transport knows it."""
    return caller.identity if caller.peer is None else caller.peer.kernel


def sent(answer: Answer) -> bytes:
    """The answer as one frame."""
    return replace(answer, protocol=versions.SPOKEN).to_bytes()


def refusal(what: str, caller: Caller, error: WiringError) -> bytes:
    """The answer that says why it is refused."""
    _LOG.warning("W-LINK: refused %s of %s: %s", what, name_of(caller), error)
    return sent(Answer(refused=str(error)))


def check_theirs(path: Path, caller: Caller) -> None:
    """WiringError: the port is not one of the kernel that asks."""
    if caller.peer is None or path.kernel != caller.peer.kernel:
        raise WiringError(f"{path}: is no port of {name_of(caller)}, which asks")


def is_end(port: Port[Any], found: Port[Any]) -> bool:
    """Whether this port of a connector is this one that was found, or stands for it."""
    return port is found or (found.elsewhere is not None and getattr(port, "far", None) == found.elsewhere)
