"""Errors as HTTP has them: a status by the error's code, and a JSON object that says what is wrong (RFC 9457)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final

from aiorts.errors import AiortsError

CONFLICT: Final = 409
"""The kernel has understood the request, and cannot carry it out in its present state: the status of most errors."""
_STATUS: Final[Mapping[str, int]] = MappingProxyType(
    {
        "E-RECORD": 400,
        "E-TOO-LARGE": 413,
        "E-DENIED": 403,
        "E-ABSENT": 404,
        "E-UNKNOWN-TYPE": 404,
        "E-BUSY": 429,
        "E-CLOSED": 503,
        "E-STALE": 503,
        "E-NO-ANSWER": 504,
    }
)
STATUSES: Final = (400, 401, 403, 404, 405, 408, 409, 413, 415, 429, 503, 504)
"""The statuses of all answers that are problems."""


class HttpError(AiortsError):
    """An error of a request, with the status that HTTP has for it."""

    def __init__(self, status: int, code: str, text: str, headers: Mapping[str, str] = MappingProxyType({})) -> None:
        super().__init__(text)
        self.status = status
        self.code = code  # type: ignore[misc] # of each error its own
        self.headers = headers


def status_of(error: AiortsError) -> int:
    """The status of an answer that is this error."""
    return error.status if isinstance(error, HttpError) else _STATUS.get(error.code, CONFLICT)


def problem_of(error: AiortsError) -> dict[str, Any]:
    """The body of an answer that is this error; `error-codes` of the guide has the codes."""
    return {"status": status_of(error), "code": error.code, "detail": str(error)}
