"""The proof that the process at the other end of a socket is of the same program: both know one secret."""

from __future__ import annotations

import hashlib
import hmac
import os
import struct
from typing import Final

_HEAD: Final = struct.Struct("<Q")


def proof(program: bytes, prover: bytes, verifier: bytes) -> bytes:
    """A proof for `verifier` that this process, as `prover`, knows `program`.

    The secret itself is never sent: a greeting goes to every kernel of the user, and a kernel of another program
    could repeat it. The number of the process is in the proof, too: the system names the socket's process.
    """
    head = _HEAD.pack(os.getpid())
    return head + _code(program, head, prover, verifier)


def proves(program: bytes, said: bytes, prover: bytes, verifier: bytes, process: int) -> bool:
    """Whether `said` was made by `prover`, which the system says to be `process`, with the same secret.

    For a socket pair the system names the process that made it at both ends, also where another has inherited one.
    """
    head = said[: _HEAD.size]
    if not program or len(head) < _HEAD.size or process not in (*_HEAD.unpack(head), os.getpid()):
        return False
    return hmac.compare_digest(said[_HEAD.size :], _code(program, head, prover, verifier))


def _code(program: bytes, head: bytes, prover: bytes, verifier: bytes) -> bytes:
    text = b"".join((head, len(prover).to_bytes(4, "little"), prover, verifier))
    return hmac.new(program, b"aiorts program" + text, hashlib.sha256).digest()
