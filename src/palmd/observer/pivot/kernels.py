"""What is compiled for observing a pivoting grasp."""

from __future__ import annotations

from palmd.observer.kernels import Part


def needed(_config: object) -> list[Part]:
    """As `palmd.observer.kernels.needed`, whatever the configuration says."""
    from palmd.model import pivot

    return [("pivoting grasp", lambda: pivot.library().backend)]
