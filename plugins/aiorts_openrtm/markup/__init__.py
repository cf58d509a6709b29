"""The text of a file as a tree of elements: XML and YAML in, XML and YAML out. It knows no profile."""
