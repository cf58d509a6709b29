"""FlexiFilter and its language of maps from in-ports to out-ports."""
