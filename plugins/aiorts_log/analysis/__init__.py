"""Works on whole recordings: figures, conversion, comparison, series, plots."""
