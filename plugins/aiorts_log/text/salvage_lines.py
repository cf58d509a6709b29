"""Makes a whole recording in lines from a damaged one: copies every line that is a sample, and reports the others."""

from __future__ import annotations

import json
import os
from pathlib import Path

from aiorts.errors import AiortsError
from aiorts.progress import Step
from aiorts_log.mcap.format import BadBytes
from aiorts_log.mcap.salvage import SalvageReport
from aiorts_log.mcap.survey import Gap
from aiorts_log.text.flat import FlatReader, note
from aiorts_log.text.text_format import TextReader
from aiorts_log.whole import whole_file

_BUFFER = 2**20


def salvage_lines(reader: FlatReader, target: Path, overwrite: bool, step: Step) -> SalvageReport:
    """Copy the whole lines of a recording into a new one; arguments and errors as of `salvage`.

    `step` is called with the bytes of each line.
    """
    samples: dict[str, int] = {}
    lost: list[Gap] = []
    total = 0
    with whole_file(target, [reader.path], overwrite) as part:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb", buffering=_BUFFER) as file:
            at = 0
            for number, line in enumerate(reader.lines(), 1):
                begin, at = at, at + len(line) + 1
                step(at - begin)
                if line[:1] == b"#" or not line.strip():
                    if not line.startswith(b'# {"end": '):
                        file.write(line + b"\n")
                    continue
                try:
                    name = _sample(reader, line)
                except (BadBytes, AiortsError) as error:
                    note(lost, Gap(begin, len(line), f"line {number}: {error}"))
                    continue
                file.write(line + b"\n")
                samples[name] = samples.get(name, 0) + 1
                total += 1
            if isinstance(reader, TextReader):
                entry = {"end": {"why": "salvaged", "stored": total}, "samples": total}
                file.write(f"# {json.dumps(entry)}\n".encode())
    names = tuple(one.name for one in reader.attachments())
    return SalvageReport(samples, tuple(lost), {}, reader.clean, names)


def _sample(reader: FlatReader, line: bytes) -> str:
    """The name of the port of a line. BadBytes or AiortsError when it is no sample."""
    head = reader.head(line)
    port = reader.port_of(head.key)
    reader.whole(head.data)
    if not port.unknown:
        port.decode(head.data)
    return port.name
