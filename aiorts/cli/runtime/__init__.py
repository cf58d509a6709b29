"""What a command does while a system runs: signals, status line, log, dump, the end."""
