"""Orders of those that may not give any, and orders that were given once: none takes effect."""

from __future__ import annotations

import asyncio
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from aiorts.sessions import FURTHER

pytest.importorskip("zenoh")
pytest.importorskip("cryptography")

import msgpack
import zenoh

from aiorts_zenoh import NetworkSettings
from aiorts_zenoh.engine import Engine
from aiorts_zenoh.gateway import Gateway
from aiorts_zenoh.keys import ClientKeys
from aiorts_zenoh.network import engine_settings
from network.certificate_parts import folder
from network.engine_parts import BASE, session
from network.test_other_hosts import Far
from network.test_security import SecuredFar

pytestmark = pytest.mark.slow(
    kept_by="network/test_access.py::test_what_a_name_may_send_is_its_own_and_forged_names_are_not"
)

WAIT = 30.0
ORDERS = 1_000
TIMES = 50
CHANGES: list[tuple[str, dict[str, Any]]] = [
    ("deactivate", {"component": "counter"}),
    ("configure", {"component": "counter", "values": {"": {"step": "7"}}}),
    ("remove", {"components": ["counter"]}),
    ("stop", {}),
]


def until(good: Any) -> None:
    """Wait until it is so."""
    limit = time.monotonic() + WAIT
    while not good():
        assert time.monotonic() < limit
        time.sleep(0.1)


@pytest.mark.fault("E19")
def test_of_a_thousand_orders_of_a_viewer_none_takes_effect_and_each_is_refused_or_not_heard(tmp_path: Path) -> None:
    certificates = folder(tmp_path / "certs", robot="component", anna="viewer", otto="operator")
    far = SecuredFar(tmp_path, certificates.path, "--allow-control", "-v")
    try:
        until(lambda: far.do_as("anna", "ls")[1].split() == ["robot/", "counter"])
        with session(certificates, "anna", guarded=False, mode="client", connect=far.address) as anna:

            def order(branch: str, caller: str, number: int) -> list[Any]:
                operation, arguments = CHANGES[number % len(CHANGES)]
                key = f"{BASE}/{branch}/far/robot/*/{caller}/{operation}"
                replies = anna.get(key, payload=msgpack.packb(arguments), timeout=0.2 if branch == "ctl" else WAIT)
                return [msgpack.unpackb(one.ok.payload.to_bytes()) for one in replies if one.ok is not None]

            for number in range(ORDERS):
                way = 0 if number % 10 < 8 else number % 2 + 1
                branch, caller = (("info", "anna"), ("ctl", "anna"), ("ctl", "otto"))[way]
                answers = order(branch, caller, number)
                codes = [one["error"]["code"] for one in answers]  # at `ctl` the engine hears nobody but operators
                assert codes == (["E-DENIED"] if branch == "info" else []), (number, branch, caller, answers)
        status, said, _ = far.do_as("anna", "ls", "-l")
        assert (status, "counter" in said, "inactive" in said) == (0, True, False), said
        assert far.step() == 1
        audit = [line for line in far.log.read_text().splitlines() if "[anna, another host]" in line]
        refused = 'what="deactivate" outcome="refused E-DENIED: '
        assert any(refused in line for line in audit), far.log.read_text()[-2000:]
        assert not [line for line in far.log.read_text().splitlines() if line.endswith('outcome="done"')]
    finally:
        far.close()


@pytest.mark.fault("E20")
def test_orders_that_were_recorded_have_no_effect_a_second_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever has recorded a session, where nothing is encrypted, puts its messages again."""
    far = Far(tmp_path, "--allow-control", "-v")
    recorded: list[tuple[str, bytes]] = []
    put = Engine.put

    def noted(self: Engine, key: str, data: bytes, *, urgent: bool = True) -> None:
        if key.endswith("/c"):
            recorded.append((key, data))
        put(self, key, data, urgent=urgent)

    monkeypatch.setattr(Engine, "put", noted)
    settings = engine_settings(NetworkSettings(connect=far.address, insecure=True))

    async def give() -> None:
        """Set the parameter once, as `aiorts at` does."""
        (tmp_path / "sockets").mkdir(mode=0o700)
        own = {**settings, "connect/timeout_ms": 3_000, "connect/exit_on_failure": True}
        gateway = Gateway(tmp_path / "sockets", ClientKeys("default", "tester"), own)
        await gateway.open()
        try:
            environment = os.environ | {FURTHER: str(tmp_path / "sockets"), "XDG_RUNTIME_DIR": far.folders[0]}
            words = (sys.executable, "-m", "aiorts", "conf", "counter", "step=5")
            process = await asyncio.create_subprocess_exec(*words, env=environment)
            assert await asyncio.wait_for(process.wait(), WAIT) == 0
        finally:
            await gateway.close()

    def again(change: Any) -> None:
        with zenoh.open(config_of(settings)) as thief:
            for _ in range(TIMES):
                for key, data in recorded:
                    thief.put(change(key), data, congestion_control=zenoh.CongestionControl.BLOCK)
                time.sleep(0.02)
            time.sleep(1.0)

    try:
        until(lambda: "counter" in far.do("ls")[1])
        asyncio.run(give())
        assert far.step() == 5
        assert any(b"configure" in data for _, data in recorded), "the order itself was recorded"
        assert far.do("conf", "counter", "step=1")[0] == 0
        again(lambda key: key)
        assert far.step() == 1, "in its own session"
        epoch = recorded[0][0].split("/")[6]
        far.process.kill()
        far.process.wait(WAIT)
        far.begin()
        until(lambda: "counter" in far.do("ls")[1])
        (token,) = {key.split("/")[6] for key in hellos(settings)}
        assert token != epoch
        again(lambda key: key)
        again(lambda key: key.replace(epoch, token))
        assert far.step() == 1, "of the kernel that was there before"
    finally:
        far.close()


def config_of(settings: Any) -> Any:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def hellos(settings: Any) -> list[str]:
    """The keys at which kernels say that they are there."""
    with zenoh.open(config_of(settings)) as asks:
        key = "aiorts/1/default/info/*/*/*/me/hello"
        return [str(one.ok.key_expr) for one in asks.get(key, timeout=WAIT, target=zenoh.QueryTarget.ALL) if one.ok]
