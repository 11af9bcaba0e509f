"""CasADi's functions of the models, each derived once a process: their symbols take longer than a test's numbers."""

from functools import cache


@cache
def derived(make, *arguments, **how):
    """What `make` makes of them; nobody changes it."""
    return make(*arguments, **how)
