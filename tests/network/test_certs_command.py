"""`aiorts certs`: what it makes, what it says, and that keys stay where they are."""

from __future__ import annotations

import json
import stat
import sys
from pathlib import Path

import pytest

from aiorts import exits

pytest.importorskip("cryptography")

from aiorts.cli.app import run_command
from aiorts_zenoh.security.folder import Folder
from network.certificate_parts import issue_later


@pytest.fixture
def where(tmp_path: Path) -> Path:
    assert run_command(["certs", "init", "--folder", str(tmp_path / "certs")]) == exits.DONE
    return tmp_path / "certs"


def certs(where: Path, *words: str) -> int:
    return run_command(["certs", *words, "--folder", str(where)])


def test_names_are_certified_listed_checked_and_revoked(where: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert certs(where, "issue", "robot", "--role", "component", "--address", "pc1.local", "--address", "10.0.0.7") == 0
    assert certs(where, "issue", "anna", "--role", "viewer") == 0
    assert sorted(path.name for path in where.iterdir()) == sorted(
        ["ca.key", "ca.pem", "index.json", "robot.key", "robot.pem", "anna.key", "anna.pem"]
    )
    modes = {path.suffix: stat.S_IMODE(path.stat().st_mode) for path in where.iterdir()}
    assert (modes[".key"], stat.S_IMODE(where.stat().st_mode)) == (0o600, 0o700)
    found = Folder(where).facts("robot")
    assert (found.name, found.role, found.certified, found.fits_key) == ("robot", "component", True, True)
    assert set(found.addresses) == {"localhost", "127.0.0.1", "::1", "pc1.local", "10.0.0.7"}
    assert 30 <= (found.ends - found.begins).days <= 31
    capfd.readouterr()
    assert certs(where, "list") == exits.DONE
    lines = capfd.readouterr().out.splitlines()
    assert [line.split()[:2] for line in lines] == [["anna", "viewer"], ["robot", "component"]]
    assert certs(where, "check") == exits.DONE
    assert certs(where, "revoke", "robot") == exits.DONE
    assert certs(where, "check", "robot") == exits.FAILED
    assert "revoked" in capfd.readouterr().out
    assert json.loads((where / "index.json").read_text())["revoked"] == ["robot"]
    assert (dict(Folder(where).access.roles), Folder(where).access.denied) == ({"anna": "viewer"}, {"robot"})


def test_a_certificate_is_renewed_with_its_role_and_addresses(where: Path) -> None:
    certs(where, "issue", "robot", "--role", "component", "--address", "10.0.0.7")
    before = Folder(where).facts("robot"), (where / "robot.key").read_bytes()
    assert certs(where, "issue", "robot") == exits.DONE
    after = Folder(where).facts("robot")
    assert (after.role, after.addresses) == ("component", before[0].addresses)
    assert (where / "robot.key").read_bytes() != before[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("init",), "has an authority already"),
        (("issue", "robot"), "role: expected viewer, operator, component, coordinator, router, got ''"),
        (("issue", "a/b", "--role", "viewer"), "name: expected at most 64 letters"),
        (("issue", "-a", "--role", "viewer"), "No such option"),
        (("issue", "ca", "--role", "viewer"), "name: 'ca' is the authority's own"),
        (("issue", "a", "--role", "boss"), "'boss' is not one of"),
        (("issue", "a", "--role", "viewer", "--days", "0"), "Invalid value for '--days'"),
        (("issue", "a", "--role", "viewer", "--address", "a b"), "address: expected a host name or an IP address"),
        (("issue", "a", "--role", "viewer", "--address", ""), "address: expected a host name or an IP address"),
        (("revoke", "nobody"), "name: 'nobody' has no certificate here; there are none"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    where: Path, words: tuple[str, ...], said: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert certs(where, *words) == exits.REFUSED
    assert said in capfd.readouterr().err
    assert sorted(path.name for path in where.iterdir()) == ["ca.key", "ca.pem", "index.json"]


def test_a_revoked_name_is_not_certified_again(where: Path, capfd: pytest.CaptureFixture[str]) -> None:
    certs(where, "issue", "robot", "--role", "component")
    certs(where, "revoke", "robot")
    assert certs(where, "issue", "robot") == exits.REFUSED
    assert "'robot' was revoked, and stays so" in capfd.readouterr().err


def test_what_is_wrong_with_each_is_said_and_no_key_shown(where: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for name in ("good", "late", "open"):
        certs(where, "issue", name, "--role", "component")
    issue_later(Folder(where), "late", -2.0)
    (where / "open.key").chmod(0o640)
    capfd.readouterr()
    assert certs(where, "check") == exits.FAILED
    said = capfd.readouterr()
    assert [line.partition(":")[0] for line in said.out.splitlines()] == ["good", "late", "open"]
    assert "has expired on" in said.out
    assert "has mode 0640, so others can read the key; chmod 600" in said.out
    secret = "".join((where / "open.key").read_text().splitlines()[1:3])
    assert secret not in said.out.replace("\n", "") + said.err


def test_without_its_package_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "aiorts_zenoh.security.certificates", raising=False)
    monkeypatch.setitem(sys.modules, "cryptography", None)
    assert certs(tmp_path / "new", "init") == exits.REFUSED
    assert 'pip install "aiorts[zenoh]"' in capfd.readouterr().err
    assert not (tmp_path / "new").exists()
