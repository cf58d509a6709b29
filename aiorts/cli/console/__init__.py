"""Input and output of all commands: names, error lines with codes, quotes of files, JSON, completion."""
