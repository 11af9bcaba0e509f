"""The emulated object on palms with Coulomb friction and no dither: contacts stick or slip. Pure.

A slipping contact has friction μ_k N against its slip. A sticking contact is a constraint: the body's material there
does not move along the palm, and friction takes the value that this requires, up to μ_s N. There is no creep. Contacts
change their mode between steps only:

    slip → stick      the slip has reached zero, where the step is made to end, and at most μ_s N is required
    stick → slip      more than μ_s N is required
    both stick        only while the palms do not rotate relative to each other: three velocities cannot satisfy four
                      conditions. The division of friction between them is then undetermined: palm 2 keeps its friction,
                      and slips if palm 1 would need more than μ_s N

If both come to rest on palms that rotate relative to each other one must slip: a contact that was sticking keeps
sticking if it can, as on elastic pads, where the contact that slipped is unloaded first.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

from palmd.events import PalmMotion
from palmd.rig.plant import (
    _DRIFT_RATE,
    _NO_FORCE,
    BodyState,
    BothContacts,
    ContactMotion,
    FrictionSurface,
    PalmFrame,
    Plant,
    UnitForce,
    _extrapolated_back,
    _Rates,
    closing_forces,
    gap_response,
    unit_force,
)

DRY = FrictionSurface(mu=0.2, static=0.3)
"""Friction of typical dry, clean surfaces."""

_ZERO_SLIP = 1e-5  # m/s: a contact that slips no faster is at rest
_MAX_CROSSINGS = 4  # zero crossings of a slip at which one step is divided
_RELATIVE_REST = 1e-9  # rad/s and rad/s²: slower relative rotation of the palms counts as none
_SIGNS: Final = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))


class DryPlant(Plant):
    """As `Plant`, with friction coefficient `surface.mu` while slipping and up to `surface.static` while sticking."""

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        self._ratios = [0.0, 0.0]  # of friction to normal force, against t
        self._sticking_contact: int | None = None  # whose friction is solved for, 0 or 1
        super().place(palms, psi, omega0)

    def slips(self) -> tuple[float, float]:
        """Slip of the body's material along t1 and t2 relative to the palms' (m/s); 0 for an open contact."""
        one, two = self._contacts_at(self._frame, self.state)
        return one.slip if one else 0.0, two.slip if two else 0.0

    def sticking(self) -> tuple[bool, bool]:
        """Which contacts stick."""
        one, two = (on and abs(slip) <= _ZERO_SLIP for on, slip in zip(self.touching, self.slips(), strict=True))
        return one, two

    # -- time steps ---------------------------------------------------------------------------------------

    def _step(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """Runge–Kutta steps, each until the next contact stops slipping."""
        if self.fallen:
            super()._step(middle, end, dt)
            return
        remaining = dt
        for number in range(_MAX_CROSSINGS + 1):
            self._update_tangent_planes()
            start, frame, slips_before = replace(self.state), self._frame, self.slips()
            self._t += remaining
            self._integrate(middle, end, remaining)
            fraction = _fraction_to_first_stop(slips_before, self.slips())
            if fraction == 1.0 or number == _MAX_CROSSINGS:
                break
            self.state, self._frame = start, frame
            step, remaining = fraction * remaining, (1.0 - fraction) * remaining
            self._t -= remaining
            self._integrate(_extrapolated_back(end, remaining + 0.5 * step), _extrapolated_back(end, remaining), step)
            self._settle_contacts()
            if self.fallen:
                return
            middle = _extrapolated_back(end, 0.5 * remaining)
        self._settle_contacts()

    def _accelerations(self) -> _Rates:
        """Choose the contacts' modes for the next step, and return the accelerations."""
        contacts = self._contacts_at(self._frame, self.state)
        resting = [i for i, at in enumerate(contacts) if at and abs(at.slip) <= _ZERO_SLIP]
        for i, at in enumerate(contacts):
            if at and i not in resting:
                self._ratios[i] = math.copysign(self._kinetic(i), at.slip)
        if len(resting) == 2:
            return self._both_at_rest(contacts)
        if not resting:
            self._sticking_contact = None
            return self._accelerations_for(contacts)
        (i,) = resting
        if (rates := self._if_sticking(contacts, i)) is None:
            self._sticking_contact, self._ratios[i] = None, math.copysign(self._kinetic(i), self._ratios[i])
            rates = self._accelerations_for(contacts)
        return rates

    def _both_at_rest(self, contacts: BothContacts) -> _Rates:
        previous = self._sticking_contact
        one, two = self._frame.palms
        if max(abs(two.turn - one.turn), abs(two.alpha - one.alpha)) < _RELATIVE_REST:
            for i in (0, 1):
                if (sticking := self._if_sticking(contacts, i)) is not None:
                    return sticking
                self._ratios[i] = math.copysign(self._static(i), self._ratios[i])
        else:
            for i in (0, 1) if previous != 1 else (1, 0):
                self._sticking_contact = i
                rate = self._slip_rates(contacts, self._accelerations_for(contacts))[1 - i]  # for any friction
                self._ratios[1 - i] = math.copysign(self._kinetic(1 - i), rate)
                if (sticking := self._if_sticking(contacts, i)) is not None:
                    return sticking
        self._sticking_contact = None
        rates = self._rates
        for signs in _SIGNS:
            self._ratios = [sign * self._kinetic(i) for i, sign in enumerate(signs)]
            rates = self._accelerations_for(contacts)
            if all(sign * rate > 0.0 for sign, rate in zip(signs, self._slip_rates(contacts, rates), strict=True)):
                break
        return rates

    def _accelerations_for(self, contacts: BothContacts) -> _Rates:
        return self._constrained(contacts, self.state.omega0)

    def _if_sticking(self, contacts: BothContacts, i: int) -> _Rates | None:
        """The accelerations if contact i sticks; None if that requires more friction than available."""
        self._sticking_contact = i
        rates = self._accelerations_for(contacts)
        return rates if abs(self._ratios[i]) <= self._static(i) else None

    def _kinetic(self, i: int) -> float:
        return self.surface.mu * self._frictions[i]

    def _static(self, i: int) -> float:
        return max(self.surface.static, self.surface.mu) * self._frictions[i]

    # -- equations ----------------------------------------------------------------------------------------

    def _solve(self, frame: PalmFrame, q: BodyState) -> _Rates:
        return self._constrained(self._contacts_at(frame, q), q.omega0)

    def _constrained(self, contacts: BothContacts, w: float) -> _Rates:
        """Accelerations and normal forces from γ̈ = 0 at each contact and constant zero slip at the sticking one.

        Stores the friction that sticking requires in `_ratios`.
        """
        rho2 = self.body.rho**2
        sticking = contacts[self._sticking_contact] if self._sticking_contact is not None else None
        one, two = (
            unit_force(at, 0.0 if at is sticking else k) if at else _NO_FORCE
            for at, k in zip(contacts, self._ratios, strict=True)
        )
        a11, a12, b1 = self._row(contacts[0], one, two, sticking) if contacts[0] else (1.0, 0.0, 0.0)
        a21, a22, b2 = self._row(contacts[1], one, two, sticking) if contacts[1] else (0.0, 1.0, 0.0)
        f1, f2 = closing_forces(a11, a12, a21, a22, b1, b2)
        ax, ay = f1 * one.fx + f2 * two.fx, f1 * one.fy + f2 * two.fy
        al = (f1 * one.torque + f2 * two.torque) / rho2
        if sticking is not None and self._sticking_contact is not None:
            friction = (sticking.slip_rate + sticking.tx * ax + sticking.ty * ay + sticking.h * al) / (
                1.0 + sticking.h * sticking.h / rho2
            )
            ax, ay, al = ax - friction * sticking.tx, ay - friction * sticking.ty, al - friction * sticking.h / rho2
            force = f2 if self._sticking_contact else f1
            self._ratios[self._sticking_contact] = (
                friction / force if force > 0.0 else math.copysign(math.inf, friction)
            )
        return ax, ay - self._gravity_now(), al - self.surface.damping * w / rho2, f1, f2

    def _row(
        self, at: ContactMotion, one: UnitForce, two: UnitForce, sticking: ContactMotion | None
    ) -> tuple[float, float, float]:
        """A row of γ̈ = A·f + b: the coefficients of both normal forces, with the sticking constraint, and b."""
        rho2 = self.body.rho**2
        a1, a2 = gap_response(at, one, rho2), gap_response(at, two, rho2)
        if sticking is None:
            return a1, a2, at.gap_acceleration
        coupling = at.tx * sticking.ty - at.ty * sticking.tx + at.slope * sticking.h / rho2
        coupling /= 1.0 + sticking.h * sticking.h / rho2
        b1, b2 = (sticking.tx * by.fx + sticking.ty * by.fy + sticking.h * by.torque / rho2 for by in (one, two))
        return a1 - coupling * b1, a2 - coupling * b2, at.gap_acceleration - coupling * sticking.slip_rate

    def _slip_rates(self, contacts: BothContacts, rates: _Rates) -> tuple[float, float]:
        """d(slip)/dt at both contacts (m/s²) for these accelerations."""
        ax, ay, al, _, _ = rates
        ay += self._gravity_now()
        al += self.surface.damping * self.state.omega0 / self.body.rho**2
        one, two = (
            at.slip_rate - _DRIFT_RATE * at.slip + at.tx * ax + at.ty * ay + at.h * al if at else 0.0 for at in contacts
        )
        return one, two


def _fraction_to_first_stop(before: tuple[float, float], after: tuple[float, float]) -> float:
    """The fraction of a step after which the first slip reaches zero; 1 if none changes its sign."""
    return min(
        (u / (u - v) for u, v in zip(before, after, strict=True) if abs(u) > _ZERO_SLIP and u * v < 0.0), default=1.0
    )
