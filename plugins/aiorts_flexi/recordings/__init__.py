"""FlexiLogger: records any ports, and plays recordings back."""
