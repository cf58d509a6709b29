"""Who may connect: programs and pages of this machine, and pages that the user trusts."""

from __future__ import annotations

import pytest

from aiorts_foxglove.admission import ORIGINS, refusal


@pytest.mark.parametrize("host", ["localhost", "localhost:8765", "127.0.0.1:1", "[::1]:8765", "LOCALHOST:2"])
@pytest.mark.parametrize(
    "origins", [[], ["https://app.foxglove.dev"], ["http://localhost:8080"], ["http://127.0.0.1"], ["http://[::1]:3"]]
)
def test_programs_and_pages_of_this_machine_and_foxglove_may(host: str, origins: list[str]) -> None:
    assert refusal([host], origins, ORIGINS) == ""


@pytest.mark.parametrize(
    "hosts",
    [
        *([], [""], ["evil.example"], ["evil.example:8765"], ["localhost.evil.example"], ["localhost", "evil.example"]),
        *(["192.168.0.1"], ["user@localhost"], ["localhost/evil"], ["localhost:port"], ["[::1"], ["0.0.0.0"]),
    ],
)
def test_a_name_that_leads_here_is_refused(hosts: list[str]) -> None:
    assert "expected localhost or 127.0.0.1" in refusal(hosts, [], ORIGINS)


@pytest.mark.parametrize(
    "origins",
    [
        *(["https://evil.example"], ["https://app.foxglove.dev.evil.example"], ["null"], [""], ["file://"]),
        *(["http://app.foxglove.dev"], ["https://app.foxglove.dev", "https://evil.example"], ["ftp://localhost"]),
        *(["http://localhost@evil.example"], ["https://localhost.evil.example"]),
    ],
)
def test_other_pages_are_refused_and_the_option_that_lets_them_in_is_named(origins: list[str]) -> None:
    assert "--origin" in refusal(["localhost"], origins, ORIGINS)


def test_an_origin_that_is_given_is_let_in() -> None:
    assert refusal(["localhost"], ["https://robots.example"], {*ORIGINS, "https://robots.example"}) == ""
