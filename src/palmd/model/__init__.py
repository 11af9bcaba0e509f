"""Symbols, equations and generated C: the only room where CasADi's symbols live."""
