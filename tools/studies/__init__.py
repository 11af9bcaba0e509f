"""Studies: code for simulation studies, the paper's figures and benchmarks; not part of the installed package."""
