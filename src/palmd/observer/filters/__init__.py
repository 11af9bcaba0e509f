"""The kinds of filters that a bank can hold, one file each: state, prior, kernels."""
