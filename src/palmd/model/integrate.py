"""Fourth-order exponential integration step, stable where dry friction is stiff.

Friction under dither acts on slow slip like a strong viscous brake: ω0 relaxes at rates up to about 1000 /s, and an
explicit Runge–Kutta step of 4 ms would be unstable. ETDRK4 (Cox and Matthews 2002) integrates this one rate exactly
and the rest as Runge–Kutta does; for a rate of zero it is the classical Runge–Kutta method.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from palmd.model.symbolic import SX, ca
from palmd.model.touch import Touch

Rates = Callable[[SX, SX], SX]
SMALL = 0.2  # |rate · step| below which the coefficients' series and its derivative are more accurate than the formula


def exponential_step(
    rates: Rates, x: SX, dt: SX, moving: Sequence[int], stiff: int, rate: SX, touch: Touch | None = None
) -> tuple[SX, SX]:
    """Return the moving states after dt, and their Jacobian by the whole state x.

    `moving`: indices of the moving states y in x. `rates(y, t)`: ẏ at t seconds into the step. `stiff`: position in y
    of the state whose own rate ∂ẏ/∂y is about `rate` (1/s) at the start; the step is of fourth order for any `rate`,
    but in the stiff case depends on it, and so does the Jacobian. `touch`: the contact search in `rates` and `rate`,
    if any.
    """
    touch = touch or Touch()
    symbol = SX.sym("rate")
    parameters = ca.vertcat(x, symbol)
    linear = SX(len(moving), 1)
    linear[stiff] = symbol
    y = ca.vertcat(*(x[i] for i in moving))
    intermediate = list[SX]()  # results of the stages, as symbols
    jacobians = list[SX]()  # of each by `parameters`

    def jacobian(value: SX) -> SX:
        """By `parameters`, also through earlier results of the stages; all derivatives in one sweep."""
        direct = ca.jacobian(value, ca.vertcat(parameters, *intermediate))
        own, *through = ca.horzsplit(direct, [0, *range(parameters.numel(), direct.shape[1] + 1, len(moving))])
        return own + sum(each @ by for each, by in zip(through, jacobians, strict=True))

    def held(value: SX) -> SX:
        """The value as symbols, so that each stage is differentiated once: the derivatives follow by the chain rule."""
        symbols = ca.vertcat(*map(touch.freeze, ca.vertsplit(value)))
        jacobians.append(jacobian(value))
        intermediate.append(symbols)
        return symbols

    def rest(state: SX, t: SX) -> SX:
        return rates(state, t) - linear * state

    z = linear * dt
    half, full = ca.exp(z / 2), ca.exp(z)
    to_middle = dt / 2 * _elementwise(_exprel, z / 2)
    n0 = held(rest(y, SX(0)))
    a = held(half * y + to_middle * n0)
    n1 = held(rest(a, dt / 2))
    b = held(half * y + to_middle * n1)
    n2 = held(rest(b, dt / 2))
    c = held(half * a + to_middle * (2 * n2 - n0))
    n3 = held(rest(c, dt))
    w0, w1, w2 = (dt * _elementwise(weight, z) for weight in (_weight_first, _weight_middle, _weight_last))
    moved = full * y + w0 * n0 + 2 * w1 * (n1 + n2) + w2 * n3
    result, by = ca.substitute(touch.thawed(moved, jacobian(moved)), [symbol], [rate])
    moved, J = touch.thawed(result, by[:, :-1] + by[:, -1] @ ca.jacobian(rate, x))
    return moved, J


def variance_share(rate: SX, dt: SX) -> SX:
    """(e²ᶻ − 1)/2z, z = rate · dt: variance of a speed driven by a white acceleration for dt, relative to rate 0.

    The speed relaxes at `rate` (1/s), negative for decay.
    """
    return _exprel(2 * rate * dt)


def _elementwise(f: Callable[[SX], SX], z: SX) -> SX:
    # most entries are structurally zero: there the weights are Runge–Kutta's plain numbers
    return ca.vertcat(*(f(z[i]) if not z[i].is_zero() else f(SX(0)) for i in range(z.shape[0])))


def _series_or(z: SX, coefficients: list[float], closed: Callable[[SX], SX]) -> SX:
    if z.is_zero():
        return SX(coefficients[0])
    series = SX(0)
    for coefficient in reversed(coefficients):
        series = series * z + coefficient
    small = ca.fabs(z) < SMALL
    return ca.if_else(small, series, closed(ca.if_else(small, SX(1), z)))


def _exprel(z: SX) -> SX:
    """(eᶻ − 1)/z."""
    return _series_or(z, [1, 1 / 2, 1 / 6, 1 / 24, 1 / 120, 1 / 720, 1 / 5040], lambda y: (ca.exp(y) - 1) / y)


def _weight_first(z: SX) -> SX:
    return _series_or(
        z,
        [1 / 6, 1 / 6, 3 / 40, 1 / 45, 5 / 1008, 1 / 1120, 7 / 51840, 1 / 56700],
        lambda y: (-4 - y + ca.exp(y) * (4 - 3 * y + y**2)) / y**3,
    )


def _weight_middle(z: SX) -> SX:
    return _series_or(
        z,
        [1 / 6, 1 / 12, 1 / 40, 1 / 180, 1 / 1008, 1 / 6720, 1 / 51840, 1 / 453600],
        lambda y: (2 + y + ca.exp(y) * (y - 2)) / y**3,
    )


def _weight_last(z: SX) -> SX:
    return _series_or(
        z,
        [1 / 6, 0, -1 / 120, -1 / 360, -1 / 1680, -1 / 10080, -1 / 72576, -1 / 604800],
        lambda y: (-4 - 3 * y - y**2 + ca.exp(y) * (4 - y)) / y**3,
    )
