"""`aiorts bench`: measures aiorts, always next to a bare baseline of the same run.

`harness/` takes the rounds and writes the reports; `push/`, `punctuality/` and `cases/` hold the benches. A package
offers its own as an entry point `aiorts.benches` that is a `Bench`. Benches read `time.perf_counter_ns`; the rest of
aiorts reads time from a `Clock` only.
"""

from __future__ import annotations

from aiorts_bench.harness.bench import Bench, Options
from aiorts_bench.harness.case import COST, Aim, Case, Measure, Reading
from aiorts_bench.harness.report import Report, Row

__all__ = ("COST", "Aim", "Bench", "Case", "Measure", "Options", "Reading", "Report", "Row")
