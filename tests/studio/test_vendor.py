"""The libraries of the page are those that their list names, each with its licence, and load without an import map.

That they are what npm has under these versions is compared by `nox -s page`, which needs npm.
"""

from __future__ import annotations

import re
from hashlib import sha256
from pathlib import Path

import aiorts_studio

VENDOR = Path(aiorts_studio.__file__).parent / "page/vendor"
LISTED = re.findall(
    r"^([0-9a-f]{64})  (\S+)  (.+)$", (VENDOR / "LICENSES.txt").read_text(encoding="utf-8"), re.MULTILINE
)


def test_each_library_is_listed_with_the_digest_that_it_has() -> None:
    assert {name: digest for digest, name, _ in LISTED} == {
        path.name: sha256(path.read_bytes()).hexdigest()
        for path in VENDOR.iterdir()
        if path.name != "LICENSES.txt" and not path.name.endswith(".d.ts")
    }


def test_each_package_in_them_has_its_licence_there() -> None:
    text = (VENDOR / "LICENSES.txt").read_text(encoding="utf-8")
    packages = {one for _, _, said in LISTED for one in re.findall(r"(\S+ [\d.]+) \(", said)}
    assert len(packages) >= 14
    for package in packages:
        _, found, licence = text.partition(f"={'=' * 79}\n{package}\n\n")
        assert found, package
        assert re.search(r"copyright|apache license", licence[:400], re.IGNORECASE), package


def test_every_import_is_relative() -> None:
    for path in VENDOR.glob("*.js"):
        imports = re.findall(r"""(?:\}from\s*|\bimport\s*\(?)["']([^"']+)["']""", path.read_text(encoding="utf-8"))
        assert all((path.parent / one).is_file() for one in imports), (path.name, imports)
