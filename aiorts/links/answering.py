"""Answers to what other kernels ask about links: with the versions that this kernel speaks; a refusal is logged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from aiorts.kernel.loop.guarded import KernelLog
from aiorts.links import versions
from aiorts.links.messages import Answer

if TYPE_CHECKING:
    from aiorts.errors import WiringError
    from aiorts.links.transport import Caller

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
