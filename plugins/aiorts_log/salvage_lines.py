"""Makes a whole recording in lines of a damaged one: what is a sample goes over as it is, the rest is told."""

from __future__ import annotations

import json
import os
from pathlib import Path

from aiorts.errors import AiortsError
from aiorts_log.flat import FlatReader, note
from aiorts_log.form import BadOctets
from aiorts_log.salvage import SalvageReport
from aiorts_log.survey import Gap
from aiorts_log.text_form import TextReader
from aiorts_log.whole import whole_file

__all__ = ("salvage_lines",)

_BUFFER = 2**20


def salvage_lines(reader: FlatReader, target: Path, overwrite: bool) -> SalvageReport:
    """Write the lines of a recording that are whole into a new one; arguments and errors as of `salvage`."""
    samples: dict[str, int] = {}
    lost: list[Gap] = []
    total = 0
    with whole_file(target, [reader.path], overwrite) as part:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb", buffering=_BUFFER) as file:
            at = 0
            for number, line in enumerate(reader.lines(), 1):
                begin, at = at, at + len(line) + 1
                if line[:1] == b"#" or not line.strip():
                    if not line.startswith(b'# {"end": '):
                        file.write(line + b"\n")
                    continue
                try:
                    name = _sample(reader, line)
                except (BadOctets, AiortsError) as error:
                    note(lost, Gap(begin, len(line), f"line {number}: {error}"))
                    continue
                file.write(line + b"\n")
                samples[name] = samples.get(name, 0) + 1
                total += 1
            if isinstance(reader, TextReader):
                said = {"end": {"why": "salvaged", "stored": total}, "samples": total}
                file.write(f"# {json.dumps(said)}\n".encode())
    names = tuple(one.name for one in reader.attachments())
    return SalvageReport(samples, tuple(lost), {}, reader.clean, names)


def _sample(reader: FlatReader, line: bytes) -> str:
    """The port of a line. BadOctets or AiortsError when it is no sample."""
    head = reader.head(line)
    port = reader.port_of(head.key)
    reader.whole(head.data)
    if not port.unknown:
        port.decode(head.data)
    return port.name
