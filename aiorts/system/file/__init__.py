"""Reads a system file into values: tables, keys, places in the text, and their faults.

No code is run but that of the types that the file names. Every error has its line.
"""
