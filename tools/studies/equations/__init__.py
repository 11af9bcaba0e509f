"""The paper's equations as they are printed, checked against derivations of our own; what they leave open."""
