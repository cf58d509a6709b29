"""The engine's settings that permit only TLS, with certificates at both ends, beyond this host."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from aiorts.errors import ConfigurationError
from aiorts_zenoh.security.access import Access, access_control
from aiorts_zenoh.security.folder import Folder, Identity


class Secured(NamedTuple):
    """The certificate that one end shows to others, and the access table."""

    identity: Identity
    access: Access


def secured_by(folder: Path, name: str, roles: Collection[str], table: Any = None) -> Secured:
    """The certificate of a name in a folder, and the access table.

    Args:
        roles: the roles of which the name needs one.
        table: names by role; None: as the folder's index says.

    Raises:
        ConfigurationError: there is no certificate, it is not to be used, or the name has no such role.
    """
    identity, access = Folder(folder).identity(name), Folder(folder).access
    if table is not None:
        access = Access.of_table(table, access.denied)
    if (role := access.roles.get(name, "")) not in roles:
        found = f"the role {role!r}" if role else "no role"
        raise ConfigurationError(f"access: {name!r} has {found}; expected {' or '.join(roles)}")
    return Secured(identity, access)


def tls_settings(secured: Secured, base: str) -> Mapping[str, Any]:
    """The engine's settings for one end, with a table of what others may send below `base`."""
    identity = secured.identity
    tls = {
        "root_ca_certificate": identity.authority,
        "listen_certificate": identity.certificate,
        "listen_private_key": identity.key,
        "connect_certificate": identity.certificate,
        "connect_private_key": identity.key,
    }
    return {
        "transport/link/protocols": ["tls"],
        **{f"transport/link/tls/{key}": str(path.absolute()) for key, path in tls.items()},
        "transport/link/tls/enable_mtls": True,
        "transport/link/tls/verify_name_on_connect": True,
        "transport/link/tls/close_link_on_expiration": True,
        "access_control": access_control(identity.name, secured.access, base),
    }
