"""The text of system files: TOML read within limits, where each key stands, and values taken out with their mistakes.

It knows no table of a system file.
"""
