"""`aiorts bench`: what push policies cost, always beside a bare baseline of the same run.

`push.py` is the table of cases, `bare.py` and `flow.py` are the workloads, `runner.py` takes the rounds, `report.py`
holds what came out, `printer.py` shows it. Here, and only here, time is asked of `time.perf_counter_ns`.
"""
