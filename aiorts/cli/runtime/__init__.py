"""The runtime of commands that run a system: signals, status line, log, dump, the end."""
