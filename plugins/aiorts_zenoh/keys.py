"""The keys of one kernel, and the names in the keys of others. Nothing is looked up here."""

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
"""The start of a kernel, its epoch and its machine: each has only one spelling, so that a claim has one token."""
BY_WRITER: Final = "w"
BY_READER: Final = "r"
"""The last part of a link's key: the end that sends."""
INFO: Final = "info"
CTL: Final = "ctl"
"""The branches of keys below which clients look into a kernel, and operate it."""
HELLO: Final = "hello"
"""The call that every kernel answers with what it is."""


def base_of(domain: str) -> str:
    """The beginning of all keys of a domain."""
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
        """The claim in the token."""
        return Claim(self.start_ns, self.own.epoch, self.machine, self.own.host, self.own.kernel)

    @property
    def token(self) -> str:
        """The token that says that this kernel is there."""
        return self.token_of(self.claim)

    @property
    def owned(self) -> str:
        """The token that says that this kernel owns its name."""
        return self.token_of(self.claim, owned=True)

    def token_of(self, claim: Claim, *, owned: bool = False) -> str:
        """The token that says that the kernel of a claim is there, or that it owns its name."""
        start = f"{claim.start_ns}-{claim.epoch:016x}-{claim.machine:016x}{f'/{_OWNED}' if owned else ''}"
        return f"{_VERSION}/{self.domain}/live/{claim.host}/{claim.kernel}/{start}"

    def told(self, peer: Peer) -> str:
        """The key at which this kernel tells `peer` of tokens that `peer` may not see: + or -, and the token."""
        return f"{_at(self.domain, 'heard', peer)}/{self.own.kernel}"

    @property
    def heard(self) -> str:
        """The keys at which others tell this kernel of tokens; the last part is the kernel that tells."""
        return f"{_at(self.domain, 'heard', self.own)}/*"

    @property
    def tokens(self) -> str:
        """All tokens of kernels that are there, or that own their names."""
        return f"{_VERSION}/{self.domain}/live/*/*/**"

    @property
    def questions(self) -> str:
        """The keys of questions to this kernel."""
        return f"{_at(self.domain, 'svc', self.own)}/**"

    def question(self, peer: Peer, what: str) -> str:
        """The key of a question to another kernel; the part before the last is the kernel that asks."""
        return f"{_at(self.domain, 'svc', peer)}/{self.own.kernel}/{what}"

    @property
    def frames(self) -> tuple[str, str]:
        """The keys at which writers and readers of links send to this kernel."""
        base, own = f"{_VERSION}/{self.domain}/link", f"{self.own.host}/{self.own.kernel}"
        return f"{base}/*/*/{own}/*/{BY_WRITER}", f"{base}/{own}/*/*/*/{BY_READER}"

    def link(self, writer: Peer, reader: Peer, name: str, sender: str) -> str:
        """The key at which one end of a link sends."""
        ends = f"{writer.host}/{writer.kernel}/{reader.host}/{reader.kernel}"
        return f"{_VERSION}/{self.domain}/link/{ends}/{name}/{sender}"

    # -- control ---------------------------------------------------------------------------------------------------

    def sessions(self, branch: str) -> str:
        """The keys at which clients send to this kernel in their sessions."""
        return f"{self._control(branch)}/*/*/c"

    def session_tokens(self, branch: str) -> str:
        """The tokens of clients that have sessions with this kernel."""
        return f"{self._control(branch)}/*/*/live"

    def session(self, branch: str, caller: str, session: str) -> str:
        """The key at which this kernel sends to a client in its session."""
        return f"{self._control(branch)}/{caller}/{session}/s"

    def calls(self, branch: str) -> str:
        """The keys of clients' calls without a session in this kernel."""
        return f"{self._control(branch)}/*/*"

    def call(self, branch: str, caller: str, operation: str) -> str:
        """The key of a client's call without a session."""
        return f"{self._control(branch)}/{caller}/{operation}"

    def _control(self, branch: str) -> str:
        return _at(self.domain, branch, self.own)


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """The keys of one client in a domain, which looks into kernels and operates them.

    Args:
        domain: the domain whose kernels it sees.
        caller: its name.
    """

    domain: str
    caller: str

    @property
    def tokens(self) -> str:
        """All tokens of kernels that own their names."""
        return f"{_VERSION}/{self.domain}/live/*/*/*/{_OWNED}"

    def answers(self, branch: str) -> str:
        """The keys at which kernels send to this client in its sessions."""
        return f"{_VERSION}/{self.domain}/{branch}/*/*/*/{self.caller}/*/s"

    def every(self, branch: str, operation: str) -> str:
        """The key of a call of this client in all kernels."""
        return f"{_VERSION}/{self.domain}/{branch}/*/*/*/{self.caller}/{operation}"

    def session(self, branch: str, peer: Peer, session: str) -> str:
        """The key of a session of this client with a kernel."""
        return f"{_at(self.domain, branch, peer)}/{self.caller}/{session}"


def _at(domain: str, branch: str, peer: Peer) -> str:
    return f"{base_of(domain)}/{branch}/{peer.host}/{peer.kernel}/{peer.epoch:016x}"


def teller_in(key: str) -> str:
    """The kernel that sends news at this key."""
    return key.rpartition("/")[2]


def denied(domain: str, name: str, teller: str) -> str:
    """The token by which `teller` tells `name` that it refuses all messages of that name from now on; `*`: any."""
    return f"{base_of(domain)}/denied/{name}/{teller}"


def session_in(key: str) -> tuple[str, str]:
    """The caller and the session that a key of a session names."""
    caller, session, _ = key.split("/")[-3:]
    return caller, session


def claim_of(token: str) -> tuple[Claim, bool] | None:
    """The claim in a token, and whether the kernel owns the name; None: the token is no kernel's."""
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
    """The kernel that asks by this key, and the name of the question."""
    *_, caller, what = key.split("/")
    return caller, what


def peer_of(key: str) -> Peer | None:
    """The kernel of an answer, or of a token, by its key; None: the key is no kernel's."""
    parts = key.split("/")
    try:
        host, name, start = parts[4:7]
        return checked_peer(host, name, int(start.split("-")[1] if parts[3] == "live" else start, 16))
    except (LinkError, ValueError, IndexError):
        return None


def whose(token: str) -> tuple[str, str] | None:
    """The host and kernel whose name a token is for; None: the token is no kernel's."""
    parts = token.split("/", 6)
    return (parts[4], parts[5]) if len(parts) > 6 and parts[3] == "live" else None


def sender_of(key: str) -> str:
    """The sender at this key: host and kernel at a link, else the name alone that the key has for it."""
    parts = key.split("/")
    if len(parts) > 8 and parts[3] == "link":
        return "/".join(parts[4:6] if parts[-1] == BY_WRITER else parts[6:8])
    return parts[7] if len(parts) > 7 else parts[-1]
