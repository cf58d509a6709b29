"""The base of every bench: cases, rounds that alternate with baselines, reports and their output."""
