"""A folder of certificates: the authority, a certificate and key for each name, and an index of roles and denied names.

    ca.pem  ca.key  index.json  NAME.pem  NAME.key

The access table is made from the index. `ca.key` stays where certificates are issued; a machine that runs kernels needs
only the other files, and of names only its own.
"""

from __future__ import annotations

import json
import os
import stat
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass
from aiorts_zenoh.security.access import ROLES, Access, check_word

if TYPE_CHECKING:
    from aiorts_zenoh.security.certificates import Facts

AUTHORITY: Final = "ca"
DAYS: Final = 30.0
"""Days that a certificate is valid."""
_INDEX: Final = "index.json"
_LARGEST: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class Identity:
    """The files that a kernel shows to others: paths, never their contents."""

    name: str
    role: str
    certificate: Path
    key: Path
    authority: Path


@dataclass(frozen=True, slots=True)
class Folder:
    """A folder of certificates. A ConfigurationError names any fault in it, and the next step."""

    path: Path

    # -- issuing ---------------------------------------------------------------------------------------------------

    def init(self) -> None:
        """Make an authority, which certifies names from now on."""
        from aiorts_zenoh.security.certificates import made_authority

        with _reported():
            if self._of(AUTHORITY, "pem").exists() or self._of(AUTHORITY, "key").exists():
                raise ConfigurationError(f"{self.path}: has an authority already; choose another folder")
            self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._write_pair(AUTHORITY, made_authority())
        self._write_index({}, ())

    def issue(self, name: str, role: str, addresses: Sequence[str] = (), days: float = DAYS) -> Identity:
        """Certify a name, or renew its certificate, with a key of its own.

        Args:
            role: the role; "" keeps the role that the name has.
            addresses: host names and IP addresses at which it listens, besides those of the loopback; none keeps those
                of its present certificate.
        """
        check_word(name, "name")
        if name == AUTHORITY:
            raise ConfigurationError(f"name: {AUTHORITY!r} is the authority's own; choose another")
        with self._held():
            return self._issue(name, role, addresses, days)

    def _issue(self, name: str, role: str, addresses: Sequence[str], days: float) -> Identity:
        roles, denied = self._index()
        if name in denied:
            raise ConfigurationError(f"name: {name!r} was revoked, and stays so; choose another name")
        role = role or roles.get(name, "")
        if role not in ROLES:
            missing = "" if role else "; the first certificate of a name needs it (--role)"
            raise ConfigurationError(f"role: expected {', '.join(ROLES)}, got {role!r:.80}{missing}")
        from aiorts_zenoh.security.certificates import made_certificate

        authority = self._read(AUTHORITY, "pem"), self._read(AUTHORITY, "key")
        if not addresses and name in roles and self._of(name, "pem").exists():
            addresses = self.facts(name).addresses
        self._write_pair(name, made_certificate(*authority, name, role, addresses, days))
        self._write_index({**roles, name: role}, denied)
        return self.identity(name)

    def revoke(self, name: str) -> None:
        """Deny a name from now on: wherever this index is, its certificate is worth nothing."""
        with self._held():
            roles, denied = self._index()
            if name not in roles:
                raise ConfigurationError(f"name: {name!r:.80} has no certificate here; there are {_listed(roles)}")
            self._write_index(roles, sorted({*denied, name}))

    # -- looking ---------------------------------------------------------------------------------------------------

    @property
    def names(self) -> Mapping[str, tuple[str, bool]]:
        """Each name with its role, and whether it is denied."""
        roles, denied = self._index()
        return {name: (role, name in denied) for name, role in roles.items()}

    @property
    def held(self) -> tuple[str, ...]:
        """The names whose certificate is in this folder and that are not denied."""
        return tuple(name for name, (_, denied) in self.names.items() if not denied and self._of(name, "pem").exists())

    @property
    def index(self) -> Path:
        """The file of roles and denied names."""
        return self.path / _INDEX

    @property
    def access(self) -> Access:
        """The roles of all names, and those that are denied."""
        roles, denied = self._index()
        return Access.of_names(roles, denied)

    def identity(self, name: str) -> Identity:
        """The certificate that the kernel of this name shows to others, checked as others will."""
        roles, denied = self._index()
        role = roles.get(name, "")
        found = Identity(name, role, self._of(name, "pem"), self._of(name, "key"), self._of(AUTHORITY, "pem"))
        with _reported():
            is_there = found.certificate.exists()
        if not is_there:
            advice = f"aiorts certs issue {name} --role ROLE; or say another name"
            raise ConfigurationError(f"{found.certificate}: {name!r} has no certificate; {advice}")
        if name in denied:
            raise ConfigurationError(f"{name!r} was revoked; give the kernel another name, and a certificate for that")
        if what := self.facts(name).fault(name, role):
            raise ConfigurationError(f"{found.certificate}: {what}")
        return found

    def facts(self, name: str) -> Facts:
        """The facts of a name's certificate. ConfigurationError: also where others can read its key."""
        from aiorts_zenoh.security.certificates import facts

        return facts(self._read(name, "pem"), self._read(name, "key"), self._read(AUTHORITY, "pem"))

    # -- files -----------------------------------------------------------------------------------------------------

    def _of(self, name: str, ending: str) -> Path:
        return self.path / f"{name}.{ending}"

    @contextmanager
    def _held(self) -> Iterator[None]:
        """Hold the lock of the index: one process at a time changes it, so that none lets in what another denies."""
        self._index()
        with _reported():
            opened = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
        try:
            with suppress(ImportError):  # not every system has it
                import fcntl

                fcntl.flock(opened, fcntl.LOCK_EX)
            yield
        finally:
            os.close(opened)

    def _index(self) -> tuple[dict[str, str], tuple[str, ...]]:
        path = self.index
        try:
            data = json.loads(_content(path))
            roles, denied = data["roles"], data["revoked"]
            good = isinstance(roles, dict) and isinstance(denied, list) and set(roles.values()) <= set(ROLES)
            for name in (*roles, *denied):
                check_word(name, "name")
        except FileNotFoundError:
            raise ConfigurationError(f"{path}: there is none; aiorts certs init --folder {self.path}") from None
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from None
        except (ValueError, TypeError, KeyError) as error:
            raise ConfigurationError(f"{path}: is no index of certificates: {error}") from None
        if not good:
            raise ConfigurationError(f"{path}: is no index of certificates")
        return roles, tuple(denied)

    def _write_index(self, roles: Mapping[str, str], denied: Sequence[str]) -> None:
        text = json.dumps({"roles": dict(sorted(roles.items())), "revoked": list(denied)}, indent=1) + "\n"
        _put(self.index, text.encode(), 0o644)

    def _write_pair(self, name: str, pair: tuple[bytes, bytes]) -> None:
        certificate, key = pair
        _put(self._of(name, "key"), key, 0o600)
        _put(self._of(name, "pem"), certificate, 0o644)

    def _read(self, name: str, ending: str) -> bytes:
        path = self._of(name, ending)
        try:
            if ending == "key" and (mode := stat.S_IMODE(path.stat().st_mode)) & 0o077:
                raise ConfigurationError(f"{path}: has mode {mode:04o}, so others can read the key; chmod 600 {path}")
            return _content(path)
        except FileNotFoundError:
            raise ConfigurationError(f"{path}: there is none") from None
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from None


@contextmanager
def _reported() -> Iterator[None]:
    """Turn errors of the system into a ConfigurationError."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{error.filename}: {error.strerror}") from None


def default_folder() -> Path:
    """The folder of certificates, unless another one is given."""
    base = os.environ.get("XDG_CONFIG_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".config") / "aiorts" / "certs"


def _content(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_LARGEST)


def _put(path: Path, data: bytes, mode: int) -> None:
    """Write a file whole or not at all; its content is never readable with a wider mode."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        handle = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
        try:
            with open(handle, "wb") as file:
                os.fchmod(file.fileno(), mode)
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            beside.replace(path)
        except BaseException:
            beside.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror}") from None


def _listed(names: Mapping[str, Any]) -> str:
    return ", ".join(sorted(names)) or "none"
