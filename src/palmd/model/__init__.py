"""Symbolic models and the C generated from them; the only package that uses CasADi's symbols."""
