"""Input and output of all commands: names, error lines with codes, excerpts of files, JSON, completion."""
