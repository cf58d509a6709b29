"""The command `aiorts new`: a plugin to begin with, from the ports, parameters and services that it is to have."""
