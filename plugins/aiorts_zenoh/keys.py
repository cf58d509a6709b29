"""What lies where: the keys of one kernel, and what the keys of others say. Nothing is looked up here."""

from __future__ import annotations

from typing import Final

from aiorts.errors import LinkError
from aiorts.late import dataclass
from aiorts.links import Peer, checked_peer

_VERSION: Final = "aiorts/1"
BY_WRITER: Final = "w"
BY_READER: Final = "r"
"""The last part of a link's key: who sends."""


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one kernel in a domain.

    Args:
        domain: kernels of different domains do not see each other.
        own: this kernel.
        start_ns: when it was started, in ns since 1970.
    """

    domain: str
    own: Peer
    start_ns: int

    @property
    def token(self) -> str:
        """That this kernel is there."""
        own = self.own
        return f"{_VERSION}/{self.domain}/live/{own.host}/{own.kernel}/{self.start_ns}-{own.epoch:016x}"

    @property
    def tokens(self) -> str:
        """That any kernel is there."""
        return f"{_VERSION}/{self.domain}/live/*/*/*"

    @property
    def namesakes(self) -> str:
        """That a kernel of this name is there on this host."""
        return f"{_VERSION}/{self.domain}/live/{self.own.host}/{self.own.kernel}/*"

    @property
    def questions(self) -> str:
        """What others ask this kernel."""
        own = self.own
        return f"{_VERSION}/{self.domain}/svc/{own.host}/{own.kernel}/{own.epoch:016x}/**"

    def question(self, peer: Peer, what: str) -> str:
        """What this kernel asks another; the part before the last is who asks."""
        whom = f"{peer.host}/{peer.kernel}/{peer.epoch:016x}"
        return f"{_VERSION}/{self.domain}/svc/{whom}/{self.own.kernel}/{what}"

    @property
    def frames(self) -> tuple[str, str]:
        """What writers and readers of links send to this kernel."""
        base, own = f"{_VERSION}/{self.domain}/link", f"{self.own.host}/{self.own.kernel}"
        return f"{base}/*/*/{own}/*/{BY_WRITER}", f"{base}/{own}/*/*/*/{BY_READER}"

    def link(self, writer: Peer, reader: Peer, name: str, sender: str) -> str:
        """What one end of a link sends."""
        ends = f"{writer.host}/{writer.kernel}/{reader.host}/{reader.kernel}"
        return f"{_VERSION}/{self.domain}/link/{ends}/{name}/{sender}"


def peer_of(token: str) -> Peer | None:
    """Who is there by this token; None: it is none of ours."""
    parts = token.split("/")
    if len(parts) != 7 or parts[3] != "live":
        return None
    host, name, start = parts[4:]
    _, _, epoch = start.partition("-")
    try:
        return checked_peer(host, name, int(epoch, 16))
    except (LinkError, ValueError):
        return None


def asked(key: str) -> tuple[str, str]:
    """Who asks by this key, and what."""
    *_, caller, what = key.split("/")
    return caller, what
