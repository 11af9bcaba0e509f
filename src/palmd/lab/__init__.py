"""Apart from all that a rig runs: what the paper's reproduction and the studies need."""
