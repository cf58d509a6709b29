"""The table of messages that each role may send to each other. Names come from certificates; nothing is looked up.

A message goes from one name to another, over the connection between them; `ROWS` says which messages a role may send
to which, with {a} for the name of the sender and {b} for that of the receiver. The engine compares both with the
certificate at the other end of the connection, so a name in a key cannot be another's. A router stands for all names:
to it and from it the other name is any. What no row allows is denied.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from aiorts.errors import ConfigurationError
from aiorts.late import dataclass

VIEWER: Final = "viewer"
OPERATOR: Final = "operator"
COMPONENT: Final = "component"
COORDINATOR: Final = "coordinator"
"""A kernel that operates others: it has composites with members there."""
ROUTER: Final = "router"
ROLES: Final = (VIEWER, OPERATOR, COMPONENT, COORDINATOR, ROUTER)
KERNELS: Final = (COMPONENT, COORDINATOR)
OPERATORS: Final = (OPERATOR, COORDINATOR)
_DENIED: Final = "denied"
"""The role of a revoked name: it receives the news that it was revoked, and nothing else."""
_ANY: Final = "*"
_WORD: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")
"""A name in a certificate: one part of a key of the engine, with at most the 64 letters of a common name."""


class Row(NamedTuple):
    """Messages that a name of the senders' roles may send to one of the receivers' roles."""

    senders: tuple[str, ...]
    receivers: tuple[str, ...]
    messages: tuple[str, ...]
    keys: tuple[str, ...]
    """The keys of these messages, below the domain."""


_LOOKERS: Final = (VIEWER, *OPERATORS)
_ALL: Final = (VIEWER, OPERATOR, *KERNELS)
_WATCH: Final = ("declare_liveliness_subscriber", "liveliness_query")
_ASK: Final = ("query", "put", "declare_subscriber", "liveliness_token")
"""The messages of a client: it calls, and has sessions, which are there for as long as their tokens."""
_OFFER: Final = ("declare_queryable", "declare_subscriber", *_WATCH)
_ANSWER: Final = ("reply", "put")

ROWS: Final = (
    # Presence: a kernel shows its own name alone.
    Row(_ALL, _ALL, _WATCH, ("live/*/*/**",)),
    Row(KERNELS, _ALL, ("liveliness_token",), ("live/*/{a}/**",)),
    # News for kernels of names that they may not see, and the kernel that tells them.
    Row(KERNELS, KERNELS, ("declare_subscriber",), ("heard/*/{a}/*/*",)),
    Row(KERNELS, KERNELS, ("put",), ("heard/*/{b}/*/{a}",)),
    # News that a name was revoked, to that name alone, and the kernel that says so.
    Row((*_ALL, _DENIED), _ALL, _WATCH, ("denied/{a}/*",)),
    Row(KERNELS, (*_ALL, _DENIED), ("liveliness_token",), ("denied/{b}/{a}",)),
    # Questions of kernels to each other.
    Row(KERNELS, KERNELS, ("declare_queryable",), ("svc/*/{a}/*/**",)),
    Row(KERNELS, KERNELS, ("query",), ("svc/*/{b}/*/{a}/**",)),
    Row(KERNELS, KERNELS, ("reply",), ("svc/*/{a}/*/{b}/**",)),
    # Frames of links: of the writer, and of the reader.
    Row(KERNELS, KERNELS, ("declare_subscriber",), ("link/*/*/*/{a}/*/w", "link/*/{a}/*/*/*/r")),
    Row(KERNELS, KERNELS, ("put",), ("link/*/{a}/*/{b}/*/w", "link/*/{b}/*/{a}/*/r")),
    # Looking into kernels, and controlling them; a call may go to all of them.
    Row(_LOOKERS, KERNELS, _ASK, ("info/*/*/*/{a}/**",)),
    Row(KERNELS, _LOOKERS, _OFFER, ("info/*/{a}/*/**",)),
    Row(KERNELS, _LOOKERS, _ANSWER, ("info/*/{a}/*/{b}/**",)),
    Row(OPERATORS, KERNELS, _ASK, ("ctl/*/*/*/{a}/**",)),
    Row(KERNELS, OPERATORS, _OFFER, ("ctl/*/{a}/*/**",)),
    Row(KERNELS, OPERATORS, _ANSWER, ("ctl/*/{a}/*/{b}/**",)),
)


@dataclass(frozen=True, slots=True)
class Access:
    """The names that have a role, and those that are denied."""

    roles: Mapping[str, str]
    denied: frozenset[str]

    @classmethod
    def of_names(cls, roles: Mapping[str, str], denied: Iterable[str] = ()) -> Access:
        """The access of names with these roles; a denied name has no role, even if `roles` has one for it."""
        out = frozenset(denied)
        return cls(MappingProxyType({name: role for name, role in roles.items() if name not in out}), out)

    @classmethod
    def of_table(cls, table: Any, denied: Iterable[str] = ()) -> Access:
        """The access by a table of names under each role. ConfigurationError: it is no such table."""
        roles: dict[str, str] = {}
        if not isinstance(table, Mapping):
            raise ConfigurationError(f"access: expected a table of names by role, got {table!r:.80}")
        for role, names in table.items():
            if role not in ROLES:
                raise ConfigurationError(f"access: expected {', '.join(ROLES)}, got {role!r:.80}")
            if not isinstance(names, (list, tuple)):
                raise ConfigurationError(f"access: {role}: expected a list of names, got {names!r:.80}")
            for name in names:
                check_word(name, f"access: {role}")
                if roles.setdefault(name, role) != role:
                    raise ConfigurationError(f"access: {name!r} is {roles[name]} and {role}; a name has one role")
        return cls.of_names(roles, denied)

    def without(self, names: Iterable[str]) -> Access:
        """This access, with further names that are denied."""
        return Access.of_names(self.roles, self.denied.union(names))

    def is_kernel(self, name: str) -> bool:
        """Whether a kernel may have this name."""
        return self.roles.get(name) in KERNELS

    def is_client(self, name: str, operates: bool) -> bool:
        """Whether a client of this name may look, or operate."""
        return self.roles.get(name) in (OPERATORS if operates else _LOOKERS)

    def fault(self, name: str) -> str:
        """The reason why a name may do nothing; "" when it has a role."""
        if name in self.denied:
            return f"{name!r} was revoked"
        new = "new names in index.json are known after the next start"
        return "" if name in self.roles else f"{name!r} has no role here; {new}"


def check_word(name: object, what: str) -> str:
    """The name, if a certificate can hold it. ConfigurationError: it cannot."""
    if not (isinstance(name, str) and _WORD.fullmatch(name)):
        raise ConfigurationError(f"{what}: expected at most 64 letters, digits, '_', '-' and '.', got {name!r:.80}")
    return name


def sends(sender: tuple[str, str], receiver: tuple[str, str], base: str) -> Iterator[tuple[str, str]]:
    """The messages and keys that a name and role may send to another, below `base`."""
    (a, a_role), (b, b_role) = sender, receiver
    if a_role == b_role == ROUTER:
        yield from ((message, f"{base}/**") for row in ROWS for message in row.messages)
        return
    a, b = (_ANY if role == ROUTER else name for name, role in (sender, receiver))
    for row in ROWS:
        if a_role in (*row.senders, ROUTER) and b_role in (*row.receivers, ROUTER):
            for key in row.keys:
                for message in row.messages:
                    yield message, f"{base}/{key.format(a=a, b=b)}"


def access_control(own: str, access: Access, base: str) -> dict[str, Any]:
    """The engine's `access_control` for `own`: the messages that each other name may send to it, and it to them."""
    me = own, access.roles[own]
    rules: list[dict[str, Any]] = []
    policies: list[dict[str, Any]] = []
    for other in (*access.roles.items(), *((name, _DENIED) for name in sorted(access.denied))):
        name, _ = other
        made = [
            *_rules(f"{name} in", "ingress", sends(other, me, base)),
            *_rules(f"{name} out", "egress", sends(me, other, base)),
        ]
        if made:
            rules += made
            policies.append({"rules": [rule["id"] for rule in made], "subjects": [name]})
    names = [policy["subjects"][0] for policy in policies]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": name, "cert_common_names": [name]} for name in names],
        "policies": policies,
    }


def _rules(word: str, flow: str, allowed: Iterable[tuple[str, str]]) -> Iterator[dict[str, Any]]:
    """A rule for each key, with all messages that may have it."""
    by_key: dict[str, dict[str, None]] = {}
    for message, key in allowed:
        by_key.setdefault(key, {})[message] = None
    for number, (key, messages) in enumerate(by_key.items()):
        yield {
            "id": f"{word} {number}",
            "messages": list(messages),
            "flows": [flow],
            "permission": "allow",
            "key_exprs": [key],
        }
