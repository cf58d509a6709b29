"""Pages of the studio in a real browser: real kernels, a real server, headless Chromium.

Playwright's own loop runs in the thread of the test as long as a browser is open, so that nothing here may use asyncio.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aiorts.sessions import entries
from control_parts import WAIT, until
from studio_parts import seconds_of

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

ROOT = Path(__file__).parents[1]
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    f"--{flag}"
    for flag in (
        *("headless=new", "no-sandbox", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking"),
        *("disable-component-update", "disable-sync", "force-color-profile=srgb", "hide-scrollbars"),
    )
]
SIZE = (1600, 1000)
WAIT_MS = 1000 * WAIT
THEMES = ("light", "dark")


@contextmanager
def browser() -> Iterator[Browser]:
    """Chromium, as Debian packages it."""
    from playwright.sync_api import sync_playwright  # late: only the extra dev has it

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        try:
            yield started
        finally:
            started.close()


@contextmanager
def kernel(name: str, *words: str | Path, folder: Path = ROOT) -> Iterator[subprocess.Popen[bytes]]:
    """`aiorts run --name NAME WORDS` from when it can be reached; what it prints is read by nobody."""
    with ended(_aiorts("run", "--name", name, *words, folder=folder)) as process:
        until(lambda: process.poll() is not None or any(one.name == name for one in entries()))
        assert process.poll() is None, f"{name} ended with {process.returncode}"
        yield process


def _aiorts(*words: str | Path, folder: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", "aiorts", *map(str, words)],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


@contextmanager
def ended(process: subprocess.Popen[bytes]) -> Iterator[subprocess.Popen[bytes]]:
    """A process that is killed at the end, also when it is stopped."""
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.kill()
        process.wait(WAIT)


@dataclass
class Served:
    """A server of the studio in a process of its own."""

    process: subprocess.Popen[str]
    origin: str
    code: str
    _token: str = ""

    @property
    def token(self) -> str:
        """The token of the first code; it is good for any number of pages."""
        if not self._token:
            self._token = self._post("/api/token", {"code": self.code})["token"]
        return self._token

    def call(self, name: str, operation: str, /, **arguments: Any) -> Any:
        """What a kernel answers, over HTTP."""
        return self._post(f"/api/kernels/{name}/{operation}", arguments, {"Authorization": f"Bearer {self.token}"})

    def _post(self, path: str, value: Any, headers: Mapping[str, str] | None = None) -> Any:
        asked = urllib.request.Request(
            self.origin + path,
            json.dumps(value).encode(),
            {"Content-Type": "application/json", "Origin": self.origin, **(headers or {})},
        )
        with urllib.request.urlopen(asked, timeout=WAIT) as answer:
            return json.load(answer)

    def cpu_seconds(self) -> float:
        """Processor time that the server has used."""
        return seconds_of(self.process.pid)


@contextmanager
def served(*words: str | Path) -> Iterator[Served]:
    """`aiorts studio WORDS`, from when it listens; killed at the end."""
    command = [sys.executable, "-m", "aiorts", "studio", "--api", *map(str, words)]
    process = subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        origin, code = process.stdout.readline().strip(), process.stdout.readline().strip()
        if not code:
            raise AssertionError(process.communicate(timeout=WAIT)[1])
        yield Served(process, origin, code)
    finally:
        process.kill()
        process.communicate(timeout=WAIT)


@dataclass
class Opened:
    """A page of the studio that is signed in, and what its console complained of."""

    page: Page
    complaints: list[str] = field(default_factory=list)

    def things(self, kind: str) -> list[dict[str, Any]]:
        """What the page's store has: "kernels", "frames", "boxes" or "edges"."""
        return self.page.evaluate("kind => import('/store.js').then(store => [...store[kind].value.values()])", kind)

    def names(self) -> set[str]:
        return {box["name"] for box in self.things("boxes")}

    def wait_for(self, condition: str, argument: Any = None) -> None:
        """Wait until an expression of JavaScript is true; `store` is the page's."""
        self.page.evaluate("() => import('/store.js').then(store => { window.store = store; })")
        self.page.wait_for_function(condition, arg=argument, timeout=WAIT_MS)

    def wait_for_boxes(self, count: int) -> None:
        self.wait_for("count => store.boxes.value.size >= count", count)
        self.page.wait_for_selector(".box", timeout=WAIT_MS)

    def choose(self, name: str) -> None:
        """Select a component, as the tree does."""
        self.wait_for(
            "name => { for (const box of store.boxes.value.values()) "
            "if (box.name === name) { store.choose('box', box.id); return true; } return false; }",
            name,
        )

    def choose_edge(self, name: str) -> None:
        """Select a connector."""
        self.wait_for(
            "name => { for (const edge of store.edges.value.values()) "
            "if (edge.name === name) { store.choose('edge', edge.id); return true; } return false; }",
            name,
        )

    def show(self, tab: str) -> None:
        """Have the panel of a tab shown."""
        button = self.page.get_by_role("tab", name=tab)
        if button.get_attribute("aria-selected") != "true":
            button.click()

    def fit(self) -> None:
        self.page.evaluate("() => document.activeElement?.blur()")
        self.page.keyboard.press("0")
        self.page.wait_for_timeout(300)

    def settle(self) -> None:
        """Wait until figures have come, and the layout stands."""
        self.wait_for("() => !store.edges.value.size || store.figures.value.size > 0")
        self.page.wait_for_timeout(700)


@contextmanager
def opened(
    started: Browser,
    site: Served,
    *,
    theme: str = "light",
    size: tuple[int, int] = SIZE,
    address: str = "",
    signed_in: bool = True,
    script: str = "",
) -> Iterator[Opened]:
    """A page in a browser context of its own, signed in by a token; a script runs before those of the page."""
    context = started.new_context(
        viewport={"width": size[0], "height": size[1]}, color_scheme=theme, reduced_motion="reduce"
    )
    context.grant_permissions(["clipboard-read", "clipboard-write"], origin=site.origin)
    if signed_in:
        context.add_init_script(f"sessionStorage.setItem('aiorts-token', {json.dumps(site.token)})")
    context.add_init_script(script)
    context.set_default_timeout(WAIT_MS)
    page = context.new_page()
    found = Opened(page)
    page.on("console", lambda said: found.complaints.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: found.complaints.append(str(error)))
    try:
        page.goto(f"{site.origin}/{address}")
        yield found
    finally:
        context.close()
