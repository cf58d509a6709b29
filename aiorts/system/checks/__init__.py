"""Finds the errors of a system file before anything runs: types, ports, options, members, plugins.

Components are made without a kernel to ask for their ports. Each finding has a code and a place.
"""
