"""Exceptions raised where readings lead beyond the range of floating-point numbers. Pure."""

from __future__ import annotations

import numpy as np

NUMERICAL_FAILURES = (np.linalg.LinAlgError, ArithmeticError)
"""A failed factorisation, overflow or division by zero: the hypothesis at hand is dropped, the others go on."""
