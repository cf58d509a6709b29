"""The RTC model as values and pure machines: lifecycle, buffers, policies, names, profiles.

It imports the standard library and `aiorts.errors` alone, never waits, and asks no clock. Everything above decides with
these tables.
"""
