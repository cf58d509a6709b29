"""What a contributor runs: `nox` for quick tests, form and types; `nox -l` lists the rest, `.ci/run` runs it all."""

from __future__ import annotations

import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import nox
from nox.command import CommandFailed

nox.options.sessions = ["quick", "lint", "types"]
nox.options.reuse_existing_virtualenvs = True

ROOT = Path(__file__).parent
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", ".nox", ".*_cache", ".hypothesis", "__pycache__")
DEPEND_ON_PYTHON = (
    *("kernel", "loop", "execution", "contexts", "ports", "services", "supervision", "diagnostics"),
    *("functions", "extensions", "realtime", "time", "wire", "testing"),
)
"""Folders of tests whose subject is different on another Python: tasks, threads, timers, signatures, codecs."""
IN_BROWSER = "tests/studio/browser"
"""Tests that need Chromium."""
WHOLE = (
    *("tests/cli/test_run.py", "tests/cli/test_filter.py", "tests/types/test_record.py"),
    *("tests/types/test_registry.py", "tests/scale/test_exact_counts.py"),
)
"""What stands for all the rest there, the slow tests too."""


def readme(name: str) -> str:
    """The command in README.md after the line `<!-- command: NAME -->`."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    found = re.search(rf"<!-- command: {name} -->\n```sh\n(.*?)```", text, re.DOTALL)
    assert found, f"README.md: no '<!-- command: {name} -->' that is followed by a block of sh"
    return found[1]


@contextmanager
def copy(session: nox.Session) -> Iterator[Path]:
    """Work in a copy of the sources, as somebody has them who has just cloned."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT, folder, ignore=NOT_COPIED, dirs_exist_ok=True)
        with session.chdir(folder):
            yield Path(folder)


@nox.session
def quick(session: nox.Session) -> None:
    """The quick tests: what README's test command runs."""
    session.install("-q", "-e", ".[test]")
    session.run("python", "-m", "pytest", "-q", "-n", "2", *session.posargs)


@nox.session
def slow(session: nox.Session) -> None:
    """The rest of the tests, but for those in a browser, which `page` runs, and what takes minutes (tests/tiers.py)."""
    session.install("-q", "-e", ".[dev]")
    # Many of them wait: two workers left a third of two processors idle.
    session.run("python", "-m", "pytest", "-q", "-n", "3", "--tier", "slow", f"--ignore={IN_BROWSER}", *session.posargs)


@nox.session
def page(session: nox.Session) -> None:
    """The studio's page: its libraries are those of npm, its types are right, and its tests in a browser."""
    folder = ROOT / ".ci/page"
    if shutil.which("npm") is None:
        print("NOT RUN types and libraries of the studio's page: there is no npm", flush=True)
    else:
        with session.chdir(folder):
            session.run("npm", "ci", "--no-audit", "--no-fund", "--loglevel=error", external=True)
            session.run("npm", "run", "--silent", "check", external=True)
            session.run("npm", "run", "--silent", "types", external=True)
    if shutil.which("chromium") is None:
        print(f"NOT RUN {IN_BROWSER}: there is no chromium", flush=True)
        return
    session.install("-q", "-e", ".[dev]")
    session.run(
        *("python", "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "--tier", "all", IN_BROWSER),
        *session.posargs,
    )


@nox.session
def campaign(session: nox.Session) -> None:
    """The long versions of tests: hours."""
    session.install("-q", "-e", ".[test]")
    session.run("python", "-m", "pytest", "-q", "--tier", "all", *session.posargs, env={"AIORTS_CAMPAIGN": "1"})


def engines_allowed() -> list[str]:
    """The versions of the engine of links to other hosts, as pyproject.toml allows them."""
    found = re.search(r"eclipse-zenoh>=1\.(\d+),<1\.(\d+)", (ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert found, "pyproject.toml: no range of eclipse-zenoh"
    return [f"1.{minor}" for minor in range(int(found[1]), int(found[2]))]


@nox.session
@nox.parametrize("version", engines_allowed())
def engine(session: nox.Session, version: str) -> None:
    """The faults of networks, made on purpose with each version of the engine that is allowed: ten minutes each."""
    session.install("-q", "-e", ".[test]")
    session.install("-q", f"eclipse-zenoh=={version}.*")
    session.run("python", "-m", "pytest", "-q", "-n", "2", "--tier", "all", "-m", "fault", "tests/network")


@nox.session(venv_backend="none")
def reports(session: nox.Session) -> None:
    """Which tests show which feature, and which hold what happens when something goes wrong: build/reports."""
    for table in ("rows", "faults"):
        session.run(sys.executable, f"tests/{table}.py", external=True)


@nox.session
def mutations(session: nox.Session) -> None:
    """Break the sources in some sixty places, one after the other: the quick tests find each."""
    session.install("-q", "-e", ".[test]")
    session.run("python", "tests/mutations.py", *session.posargs)


@nox.session
def lint(session: nox.Session) -> None:
    """Form and spelling."""
    session.install("-q", "ruff>=0.11", "codespell>=2.4")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("codespell")


@nox.session
def types(session: nox.Session) -> None:
    """Types, under mypy and pyright."""
    session.install("-q", "-e", ".[dev]")
    session.run("mypy", "--strict")
    try:
        session.run("pyright", "--version", silent=True)
    except CommandFailed:
        print("NOT RUN pyright: it does not start here; it needs node", flush=True)
    else:
        session.run("pyright", "--pythonpath", f"{session.bin}/python")


@nox.session
def docs(session: nox.Session) -> None:
    """The guide as a site, in the folder after `--` or in none that is kept; its links and anchors are checked."""
    session.install("-q", "-e", ".[docs]")
    with tempfile.TemporaryDirectory() as folder:
        site = session.posargs[0] if session.posargs else folder
        session.run(
            "mkdocs", "build", "-q", "--strict", "-f", "aiorts/guide/mkdocs.yml", "-d", str(Path(site).resolve())
        )


@nox.session
def release(session: nox.Session) -> None:
    """Source distribution and wheel, checked and installed without an index; kept in the folder after `--`."""
    session.install("-q", "build>=1.2", "twine>=6.1")
    with tempfile.TemporaryDirectory() as folder:
        session.run("python", "-m", "build", "--outdir", folder)
        made = sorted(map(str, Path(folder).iterdir()))
        session.run("twine", "check", "--strict", *made)
        wheels, new = f"{folder}/wheelhouse", f"{folder}/new"
        session.run("python", "-m", "pip", "wheel", "-q", "-w", wheels, *(one for one in made if one.endswith(".whl")))
        session.run("python", "-m", "venv", new)
        offline = ("--no-index", "--find-links", wheels)
        environment = {"PIP_CONFIG_FILE": os.devnull, "PIP_FIND_LINKS": None}
        install = (f"{new}/bin/python", "-m", "pip", "install", "-q", *offline, "aiorts")
        session.run(*install, env=environment, external=True)
        session.run(f"{new}/bin/aiorts", "demo", external=True, silent=True)
        for path in made if session.posargs else ():
            Path(session.posargs[0]).mkdir(parents=True, exist_ok=True)
            shutil.copy(path, session.posargs[0])


@nox.session(venv_backend="none")
def readme_test(session: nox.Session) -> None:
    """README's test command, to the letter, in a copy of the sources."""
    with copy(session):
        session.run("bash", "-ec", readme("test"), external=True)


@nox.session(venv_backend="none")
def readme_run(session: nox.Session) -> None:
    """README's main command, to the letter, in a copy of the sources: the heading comes out verified."""
    with copy(session):
        said = session.run("bash", "-ec", readme("run"), external=True, silent=True)
    print(said, flush=True)
    if "heading verified" not in str(said):
        session.error("its output has no 'heading verified'")


@nox.session
def examples(session: nox.Session) -> None:
    """Every example by its own command: the lines `Run: COMMAND` near the top of its files."""
    session.install("-q", ".")
    wrong = []
    for example in sorted(path for path in (ROOT / "examples").iterdir() if path.is_dir() and path.name[0] != "_"):
        files = sorted(path for path in example.rglob("*") if path.suffix in (".py", ".toml", ".md"))
        heads = ["\n".join(path.read_text(encoding="utf-8").splitlines()[:25]) for path in files]
        commands = [
            line.rstrip('"`') for head in heads for line in re.findall(r'^[#" ]*Run: (.*)$', head, re.MULTILINE)
        ]
        if not commands:
            wrong.append(f"{example.name}: none of its files has a line 'Run: COMMAND'")
        for command in commands:
            try:
                session.run("bash", "-ec", command, external=True)
            except CommandFailed:
                wrong.append(f"{example.name}: {command}")
    if wrong:
        session.error("\n".join(["", *(f"FAILED {line}" for line in wrong)]))


@nox.session
def notebook(session: nox.Session) -> None:
    """The notebook, in Jupyter."""
    session.install("-q", ".[notebook]")
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder, "executed.ipynb")
        session.run("jupyter", "execute", "--output", str(made), "examples/notebook/heading.ipynb")
        if not re.search("headings right, .* none lost", made.read_text(encoding="utf-8")):
            session.error("it does not say that all headings are right and none is lost")


def other_pythons() -> dict[str, str]:
    """Version -> interpreter, of each other CPython from 3.11 on that is found in PATH or with pyenv."""
    found, versions = {}, Path.home() / ".pyenv/versions"
    for minor in set(range(11, 20)) - {sys.version_info.minor}:
        made = {int(one.name.split(".")[2]): one for one in versions.glob(f"3.{minor}.*") if one.name[5:].isdigit()}
        path = str(made[max(made)] / "bin/python") if made else shutil.which(f"python3.{minor}")
        if path and "/shims/" not in path:
            found[f"3.{minor}"] = path
    return found


def on_another_python(session: nox.Session) -> None:
    """The quick tests of what depends on the Python."""
    session.install("-q", "-e", ".[test]")
    session.run("python", "-m", "pytest", "-q", "-n", "2", *(f"tests/{folder}" for folder in DEPEND_ON_PYTHON))
    session.run("python", "-m", "pytest", "-q", "-n", "2", "--tier", "all", *WHOLE)


for _version, _path in other_pythons().items():
    nox.session(on_another_python, python=_path, name=f"tests-{_version}")
