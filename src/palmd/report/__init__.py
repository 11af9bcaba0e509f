"""Reports of recorded runs, root-cause analysis of holds and stops, and comparisons with ground truth."""
