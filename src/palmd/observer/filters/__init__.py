"""One file for each kind of filter that a bank can hold: its state, its prior, its kernels."""
