"""CasADi functions of the models, derived once per process: derivation takes longer than evaluation."""

from functools import cache


@cache
def derived(make, *arguments, **how):
    """The cached result of `make`; callers must not change it."""
    return make(*arguments, **how)
