"""`aiorts studio` as its user has it: addresses, codes and files that only this user can open."""

from __future__ import annotations

import asyncio
import json
import re
import shutil
import signal
import ssl
import stat
import subprocess
import time
from pathlib import Path
from urllib.request import urlopen

import pytest
from websockets.asyncio.client import connect

from aiorts.cli.app import run_command
from aiorts.errors import AbsentError
from aiorts.guide import blocks, pages
from aiorts_studio.entrance import Entrance, invitations
from aiorts_studio.serving import HOST
from control_parts import WAIT, running
from studio_parts import serving, site

pytestmark = pytest.mark.row(86)
BROWSER = ("--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-port=0")


def left(runtime: str) -> list[str]:
    return sorted(path.name for path in Path(runtime).rglob("*") if not path.is_dir())


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_prints_address_and_code_and_leaves_nothing(runtime: str, number: int) -> None:
    with serving() as (process, client):
        listed = left(runtime)
        assert listed == [f"{process.pid}.sock"]
        (path,) = Path(runtime).rglob("*.sock")
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
        assert client.code not in " ".join(Path(f"/proc/{process.pid}/cmdline").read_text().split("\0"))

        async def use() -> None:
            await client.enter()
            assert (await client.ask("GET", "/api/kernels")).value == []
            async with client.socket():
                half = await asyncio.open_connection(HOST, client.port)  # that asks for nothing
                half[1].write(b"GET / HT")
                began = time.monotonic()
                process.send_signal(number)
                assert await asyncio.to_thread(process.wait, WAIT) == 0
                assert time.monotonic() - began < 10.0
                half[1].close()

        asyncio.run(use())
        assert left(runtime) == []
        assert process.stderr is not None
        assert process.stderr.read() == ""


@pytest.mark.slow
def test_the_same_user_gets_a_new_code(runtime: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["studio", "--url"]) == 6
    assert "aiorts studio --api" in capsys.readouterr().err
    with serving() as (process, client):
        assert run_command(["studio", "--url"]) == 0
        assert re.fullmatch(rf"{client.origin}/#[\w-]{{20,}}\n", capsys.readouterr().out)
        assert run_command(["studio", "--url", "--api"]) == 0
        url, code = capsys.readouterr().out.split()
        assert url == client.origin
        assert asyncio.run(client.exchange(client.code)).status == 403
        client.code = code
        asyncio.run(client.enter())
        process.kill()
        process.wait(WAIT)
        assert left(runtime) == [f"{process.pid}.sock"]
        assert run_command(["studio", "--url"]) == 6
        assert left(runtime) == []


@pytest.mark.anyio
async def test_a_browser_is_led_by_a_file_that_is_gone_when_the_code_was_used(
    runtime: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    async with site(enters=False) as client:
        assert client.api is not None
        entrance = Entrance(client.origin, client.api.codes)
        client.api.exchanged = entrance.remove_redirect
        async with entrance.open():
            invitation = entrance.invite()
            await entrance.show(invitation)
            (address,) = opened
            assert invitation.code not in address
            path = Path(address.removeprefix("file://"))
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            assert f"{client.origin}/#{invitation.code}" in path.read_text()
            client.code = invitation.code
            await client.enter()
            assert not path.exists()
            await entrance.show(entrance.invite())
            (again,) = await asyncio.to_thread(invitations)
            assert again.url == client.origin
            assert not Path(opened[1].removeprefix("file://")).exists()  # its code is none any more
            await entrance.show(entrance.invite())
        assert left(runtime) == []
        with pytest.raises(AbsentError):
            await asyncio.to_thread(invitations)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["system.toml"], "aiorts run system.toml"),
        (["--api", "--bind", "127.0.0.1"], "--certs"),
        (["--api", "--certs", "."], "--bind"),
        (["--api", "--bind", "127.0.0.1", "--certs", ".", "--edit"], "--edit"),
        (["--api", "--bind", "127.0.0.1", "--certs", ".", "--files", "."], "--files"),
        (["--api", "--bind", "127.0.0.1", "--certs", "/nowhere"], "aiorts certs init"),
    ],
)
def test_what_does_not_go_together_is_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["studio", *words]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.anyio
async def test_a_port_that_is_taken_and_a_missing_package_are_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    async with site(enters=False) as client:
        words = ["studio", "--api", "--port", str(client.port)]
        assert await asyncio.to_thread(run_command, words) == 2
        assert f"--port {client.port}" in capsys.readouterr().err
        monkeypatch.setattr("aiorts_studio.command.find_spec", lambda name: None)
        assert await asyncio.to_thread(run_command, words) == 2
        assert 'pip install "aiorts[studio]"' in capsys.readouterr().err


@pytest.mark.slow
def test_beyond_the_host_there_is_tls_with_a_certificate_for_the_address(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = ["--folder", str(tmp_path / "certs")]
    assert run_command(["certs", "init", *folder]) == 0
    assert run_command(["certs", "issue", "studio", "--role", "viewer", *folder]) == 0
    bind = ["--bind", HOST, "--certs", str(tmp_path / "certs")]
    assert run_command(["studio", "--api", "--bind", "192.0.2.1", *bind[2:]]) == 2
    assert "--address 192.0.2.1" in capsys.readouterr().err
    with serving(*bind) as (_, client):
        trusting = ssl.create_default_context(cafile=tmp_path / "certs" / "ca.pem")

        async def answered(secured: ssl.SSLContext | None) -> bytes:
            reader, writer = await asyncio.open_connection(HOST, client.port, ssl=secured)
            try:
                writer.write(f"GET / HTTP/1.1\r\nHost: {client.host}\r\nConnection: close\r\n\r\n".encode())
                return await asyncio.wait_for(reader.read(), WAIT)
            finally:
                writer.close()

        assert asyncio.run(answered(trusting)).startswith(b"HTTP/1.1 200")
        assert not asyncio.run(answered(None)).startswith(b"HTTP/1.1 200")


@pytest.mark.slow
def test_a_page_of_ten_lines_follows_a_port_in_a_browser(tmp_path: Path) -> None:
    """The page of the guide, in a browser of this machine."""
    chromium = shutil.which("chromium")
    if chromium is None:
        pytest.skip("there is no chromium on this machine")
    (guide,) = [one for one in pages() if one.name == "use-the-http-api"]
    for block in blocks(guide.text):
        if block.title:
            (tmp_path / block.title).parent.mkdir(exist_ok=True)
            (tmp_path / block.title).write_text(block.text)
    assert len((tmp_path / "pages/speed.js").read_text().splitlines()) == 10
    with (
        running("robot", str(tmp_path / "robot.toml")),
        serving("--pages", str(tmp_path / "pages")) as (_, client),
    ):
        page = f"{client.origin}/pages/speed.html#{client.code}"
        with subprocess.Popen(
            [chromium, f"--user-data-dir={tmp_path}/browser", *BROWSER, page], stderr=subprocess.PIPE, text=True
        ) as browser:
            try:
                assert browser.stderr is not None
                port = next(found[1] for line in browser.stderr if (found := re.search(r"ws://127.0.0.1:(\d+)/", line)))
                assert asyncio.run(text_of(int(port), "output")) == "1"
            finally:
                browser.kill()


async def text_of(port: int, element: str) -> str:
    """The text of an element of the page that a browser shows, once it has one."""
    with urlopen(f"http://{HOST}:{port}/json/list", timeout=WAIT) as listed:
        (page,) = [one for one in json.load(listed) if one["type"] == "page"]
    program = f"""new Promise(done => {{
        const look = () => {{
            const found = document.querySelector("{element}");
            if (found && found.textContent) done(found.textContent);
        }};
        new MutationObserver(look).observe(document, {{ subtree: true, childList: true, characterData: true }});
        look();
    }})"""
    async with asyncio.timeout(WAIT), connect(page["webSocketDebuggerUrl"]) as socket:
        await socket.send(json.dumps({"id": 1, "method": "Runtime.enable"}))
        async for message in socket:
            said = json.loads(message)
            if said.get("method") == "Runtime.executionContextCreated":  # of an empty page, and then of the one
                context = said["params"]["context"]["id"]
                asked = {"expression": program, "awaitPromise": True, "contextId": context}
                await socket.send(json.dumps({"id": 1 + context, "method": "Runtime.evaluate", "params": asked}))
            elif "value" in (found := said.get("result", {}).get("result", {})):
                return str(found["value"])
    raise AssertionError("the browser has ended")
