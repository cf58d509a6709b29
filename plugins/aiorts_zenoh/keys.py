"""What lies where: the keys of one kernel, and what the keys of others say. Nothing is looked up here."""

from __future__ import annotations

import re
from typing import Final

from aiorts.errors import LinkError
from aiorts.late import dataclass
from aiorts.links import Peer, checked_peer
from aiorts_zenoh.names import Claim

_VERSION: Final = "aiorts/1"
_OWNED: Final = "own"
_START: Final = re.compile(r"(0|[1-9][0-9]{0,18})-([0-9a-f]{16})-([0-9a-f]{16})")
"""When a kernel was started, its epoch and its machine: written in one way alone, so that one claim has one token."""
BY_WRITER: Final = "w"
BY_READER: Final = "r"
"""The last part of a link's key: who sends."""
INFO: Final = "info"
CTL: Final = "ctl"
"""Below which clients look into a kernel, and operate it."""
HELLO: Final = "hello"
"""The call that every kernel answers with what it is."""


def base_of(domain: str) -> str:
    """What all keys of a domain begin with."""
    return f"{_VERSION}/{domain}"


@dataclass(frozen=True, slots=True)
class Keys:
    """The keys of one kernel in a domain.

    Args:
        domain: kernels of different domains do not see each other.
        own: this kernel.
        start_ns: when it was started, in ns since 1970.
        machine: the number of the machine, which may share its host name with another.
    """

    domain: str
    own: Peer
    start_ns: int
    machine: int

    @property
    def claim(self) -> Claim:
        """What the token says."""
        return Claim(self.start_ns, self.own.epoch, self.machine, self.own.host, self.own.kernel)

    @property
    def token(self) -> str:
        """That this kernel is there."""
        return self.token_of(self.claim)

    @property
    def owned(self) -> str:
        """That this kernel owns its name."""
        return self.token_of(self.claim, owned=True)

    def token_of(self, claim: Claim, *, owned: bool = False) -> str:
        """That the kernel of a claim is there, or that it owns its name."""
        start = f"{claim.start_ns}-{claim.epoch:016x}-{claim.machine:016x}{f'/{_OWNED}' if owned else ''}"
        return f"{_VERSION}/{self.domain}/live/{claim.host}/{claim.kernel}/{start}"

    def told(self, peer: Peer) -> str:
        """The key at which this kernel tells another of tokens that the other may not see: + or -, and the token."""
        return f"{_at(self.domain, 'heard', peer)}/{self.own.kernel}"

    @property
    def heard(self) -> str:
        """The keys at which others tell this kernel of tokens; the last part is who tells."""
        return f"{_at(self.domain, 'heard', self.own)}/*"

    @property
    def tokens(self) -> str:
        """That any kernel is there, or owns its name."""
        return f"{_VERSION}/{self.domain}/live/*/*/**"

    @property
    def questions(self) -> str:
        """What others ask this kernel."""
        return f"{_at(self.domain, 'svc', self.own)}/**"

    def question(self, peer: Peer, what: str) -> str:
        """What this kernel asks another; the part before the last is who asks."""
        return f"{_at(self.domain, 'svc', peer)}/{self.own.kernel}/{what}"

    @property
    def frames(self) -> tuple[str, str]:
        """What writers and readers of links send to this kernel."""
        base, own = f"{_VERSION}/{self.domain}/link", f"{self.own.host}/{self.own.kernel}"
        return f"{base}/*/*/{own}/*/{BY_WRITER}", f"{base}/{own}/*/*/*/{BY_READER}"

    def link(self, writer: Peer, reader: Peer, name: str, sender: str) -> str:
        """What one end of a link sends."""
        ends = f"{writer.host}/{writer.kernel}/{reader.host}/{reader.kernel}"
        return f"{_VERSION}/{self.domain}/link/{ends}/{name}/{sender}"

    # -- control ---------------------------------------------------------------------------------------------------

    def sessions(self, branch: str) -> str:
        """What clients send to this kernel in their sessions."""
        return f"{self._control(branch)}/*/*/c"

    def session_tokens(self, branch: str) -> str:
        """That clients are there whose sessions are with this kernel."""
        return f"{self._control(branch)}/*/*/live"

    def session(self, branch: str, caller: str, session: str) -> str:
        """What this kernel sends to a client in its session."""
        return f"{self._control(branch)}/{caller}/{session}/s"

    def calls(self, branch: str) -> str:
        """Calls without a session that clients make in this kernel."""
        return f"{self._control(branch)}/*/*"

    def call(self, branch: str, caller: str, operation: str) -> str:
        """One such call of a client."""
        return f"{self._control(branch)}/{caller}/{operation}"

    def _control(self, branch: str) -> str:
        return _at(self.domain, branch, self.own)


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """The keys of one client in a domain, which looks into kernels and operates them.

    Args:
        domain: whose kernels it sees.
        caller: its name.
    """

    domain: str
    caller: str

    @property
    def tokens(self) -> str:
        """That any kernel is there and owns its name."""
        return f"{_VERSION}/{self.domain}/live/*/*/*/{_OWNED}"

    def answers(self, branch: str) -> str:
        """What kernels send to this client in its sessions."""
        return f"{_VERSION}/{self.domain}/{branch}/*/*/*/{self.caller}/*/s"

    def every(self, branch: str, operation: str) -> str:
        """A call of this client in all kernels."""
        return f"{_VERSION}/{self.domain}/{branch}/*/*/*/{self.caller}/{operation}"

    def session(self, branch: str, peer: Peer, session: str) -> str:
        """Where a session of this client with a kernel lies."""
        return f"{_at(self.domain, branch, peer)}/{self.caller}/{session}"


def _at(domain: str, branch: str, peer: Peer) -> str:
    return f"{base_of(domain)}/{branch}/{peer.host}/{peer.kernel}/{peer.epoch:016x}"


def teller_in(key: str) -> str:
    """The kernel that tells something by this key."""
    return key.rpartition("/")[2]


def denied(domain: str, name: str, teller: str) -> str:
    """The token by which a kernel or router lets a name know that it takes nothing of it any more; `*`: of any."""
    return f"{base_of(domain)}/denied/{name}/{teller}"


def session_in(key: str) -> tuple[str, str]:
    """The caller and the session that a key of a session names."""
    caller, session, _ = key.split("/")[-3:]
    return caller, session


def claim_of(token: str) -> tuple[Claim, bool] | None:
    """What a kernel claims by this token, and whether it owns it; None: it is none of ours."""
    parts = token.split("/")
    owned = parts[7:] == [_OWNED]
    if len(parts) != 7 + owned or parts[3] != "live":
        return None
    host, name, start = parts[4:7]
    if (found := _START.fullmatch(start)) is None:
        return None
    start_ns, epoch, machine = found.groups()
    try:
        peer = checked_peer(host, name, int(epoch, 16))
    except LinkError:
        return None
    return Claim(int(start_ns), peer.epoch, int(machine, 16), peer.host, peer.kernel), owned


def asked(key: str) -> tuple[str, str]:
    """Who asks by this key, and what."""
    *_, caller, what = key.split("/")
    return caller, what


def peer_of(key: str) -> Peer | None:
    """The kernel whose answer, or token, this is; None: it is none of ours."""
    parts = key.split("/")
    try:
        host, name, start = parts[4:7]
        return checked_peer(host, name, int(start.split("-")[1] if parts[3] == "live" else start, 16))
    except (LinkError, ValueError, IndexError):
        return None


def whose(token: str) -> tuple[str, str] | None:
    """The host and kernel whose name a token is for; None: it is none of a kernel."""
    parts = token.split("/", 6)
    return (parts[4], parts[5]) if len(parts) > 6 and parts[3] == "live" else None


def sender_of(key: str) -> str:
    """Who sends at this key: host and kernel at a link, else a name alone, which is in the key for it."""
    parts = key.split("/")
    if len(parts) > 8 and parts[3] == "link":
        return "/".join(parts[4:6] if parts[-1] == BY_WRITER else parts[6:8])
    return parts[7] if len(parts) > 7 else parts[-1]
