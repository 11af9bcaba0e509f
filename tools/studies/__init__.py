"""Studies: what only a study, a paper or a benchmark needs; not part of what is installed."""
