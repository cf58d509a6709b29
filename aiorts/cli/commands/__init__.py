"""The commands, one file each, imported at their use."""
