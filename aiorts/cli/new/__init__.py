"""The command `aiorts new`: writes a plugin to begin with, from the wanted ports, parameters and services."""
