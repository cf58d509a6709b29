"""The text of system files: TOML read within limits, the places of keys, and values taken out with their mistakes.

This package knows no particular table of a system file.
"""
