"""What is raised where readings lead beyond the range of numbers. Pure."""

from __future__ import annotations

import numpy as np

NUMERICAL_FAILURES = (np.linalg.LinAlgError, ArithmeticError)
"""A factorisation that fails, an overflow, a division by zero: the hypothesis at hand is dropped, the others go on."""
