"""The emulated object on palms that rub by Coulomb's law without dither: it sticks, slips, or is held. Pure.

A contact that slips is pushed back by μ_k N. One that sticks is a constraint: the body's material there does not move
along the palm, and friction is whatever that asks for, up to μ_s N. Nothing creeps. Which contact does what changes
between steps only:

    slips → sticks    its slip has come to zero, where the step is made to end, and no more than μ_s N is asked for
    sticks → slips    more than μ_s N is asked for
    both stick        only while the palms do not turn against each other: three velocities cannot meet four conditions.
                      How both share the friction is open then: palm 2 keeps what it had, and gives way where palm 1
                      would have to bear more than μ_s N

Where both come to a stop on palms that turn against each other one must slip: what has been stuck stays so if it can,
as on elastic pads, where what slipped is unloaded first.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, NamedTuple

from palmd.events import PalmMotion
from palmd.rig.plant import (
    _DRIFT_RATE,
    BodyState,
    FrictionSurface,
    PalmFrame,
    Plant,
    _before,
    _Rates,
)

DRY = FrictionSurface(mu=0.2, static=0.3)
"""What is dry and clean, by and large."""

_STOPPED = 1e-5  # m/s: a contact that slips no faster is at rest
_CROSSINGS = 4  # of zero slip, at which a step is ended before its time
_STANDING = 1e-9  # rad/s and rad/s²: palms that turn against each other no faster stand
_SIGNS: Final = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0))


class _Rubbing(NamedTuple):
    """A palm's tangent t, h and h′ at the contact, and what its gap and its slip do if nothing pushes.

    fall: γ̈, drag: the slip's rate (m/s²), both with the pull that keeps them from drifting; slip: of the body's
    material along t, against the palm's (m/s).
    """

    tx: float
    ty: float
    h: float
    slope: float
    fall: float
    drag: float
    slip: float


class _Push(NamedTuple):
    """What a unit of a contact's normal force does, with the friction that goes with it: force and torque."""

    fx: float
    fy: float
    torque: float


_BothContacts = tuple[_Rubbing | None, _Rubbing | None]


class DryPlant(Plant):
    """As `Plant`, with friction of `surface.mu` where it slips and of up to `surface.static` where it sticks."""

    def _compiled_step(self) -> None:
        """None is written for dry palms."""

    def place(self, palms: PalmMotion, psi: float, omega0: float = 0.0) -> None:
        """Puts the body on both palms at angle psi (rad), turning at omega0 (rad/s), both gaps closed."""
        self._ratios = [0.0, 0.0]  # of friction to normal force, against t
        self._held: int | None = None  # the contact whose friction is solved for, 0 or 1
        super().place(palms, psi, omega0)

    def slips(self) -> tuple[float, float]:
        """How fast the body's material slips along t1 and t2, against the palms' (m/s); 0 where nothing touches."""
        one, two = self._contacts_at(self._frame, self.state)
        return one.slip if one else 0.0, two.slip if two else 0.0

    def sticking(self) -> tuple[bool, bool]:
        """Which contacts stick."""
        one, two = (on and abs(slip) <= _STOPPED for on, slip in zip(self.touching, self.slips(), strict=True))
        return one, two

    # -- going on -----------------------------------------------------------------------------------------

    def _step(self, middle: PalmMotion, end: PalmMotion, dt: float) -> None:
        """Runge–Kutta steps, each until the next contact stops slipping."""
        if self.fallen:
            super()._step(middle, end, dt)
            return
        left = dt
        for number in range(_CROSSINGS + 1):
            self._follow_the_surfaces()
            start, frame, slipped = replace(self.state), self._frame, self.slips()
            self._t += left
            self._integrate(middle, end, left)
            share = _until_one_stops(slipped, self.slips())
            if share == 1.0 or number == _CROSSINGS:
                break
            self.state, self._frame = start, frame
            part, left = share * left, (1.0 - share) * left
            self._t -= left
            self._integrate(_before(end, left + 0.5 * part), _before(end, left), part)
            self._settle_contacts()
            if self.fallen:
                return
            middle = _before(end, 0.5 * left)
        self._settle_contacts()

    def _accelerations(self) -> _Rates:
        """What the contacts do from now on, and the accelerations with it."""
        contacts = self._contacts_at(self._frame, self.state)
        resting = [i for i, at in enumerate(contacts) if at and abs(at.slip) <= _STOPPED]
        for i, at in enumerate(contacts):
            if at and i not in resting:
                self._ratios[i] = math.copysign(self._kinetic(i), at.slip)
        if len(resting) == 2:
            return self._both_at_rest(contacts)
        if not resting:
            self._held = None
            return self._now(contacts)
        (i,) = resting
        if (rates := self._stuck(contacts, i)) is None:
            self._held, self._ratios[i] = None, math.copysign(self._kinetic(i), self._ratios[i])
            rates = self._now(contacts)
        return rates

    def _both_at_rest(self, contacts: _BothContacts) -> _Rates:
        frame, kept = self._frame, self._held
        (*_, rate, alpha, _), (*_, other_rate, other_alpha, _) = frame.each()
        if max(abs(other_rate - rate), abs(other_alpha - alpha)) < _STANDING:
            for i in (0, 1):
                if (held := self._stuck(contacts, i)) is not None:
                    return held
                self._ratios[i] = math.copysign(self._static(i), self._ratios[i])
        else:
            for i in (0, 1) if kept != 1 else (1, 0):
                self._held = i
                rate = self._slip_rates(contacts, self._now(contacts))[1 - i]  # whatever friction there is
                self._ratios[1 - i] = math.copysign(self._kinetic(1 - i), rate)
                if (held := self._stuck(contacts, i)) is not None:
                    return held
        self._held = None
        rates = self._rates
        for signs in _SIGNS:
            self._ratios = [sign * self._kinetic(i) for i, sign in enumerate(signs)]
            rates = self._now(contacts)
            if all(sign * rate > 0.0 for sign, rate in zip(signs, self._slip_rates(contacts, rates), strict=True)):
                break
        return rates

    def _now(self, contacts: _BothContacts) -> _Rates:
        return self._forced(contacts, self.state.omega0)

    def _stuck(self, contacts: _BothContacts, i: int) -> _Rates | None:
        """The accelerations if contact i sticks; None where that asks for more friction than there is."""
        self._held = i
        rates = self._now(contacts)
        return rates if abs(self._ratios[i]) <= self._static(i) else None

    def _kinetic(self, i: int) -> float:
        return self.surface.mu * self._frictions[i]

    def _static(self, i: int) -> float:
        return max(self.surface.static, self.surface.mu) * self._frictions[i]

    # -- equations ----------------------------------------------------------------------------------------

    def _solve(self, frame: PalmFrame, x: float, y: float, psi: float, vx: float, vy: float, w: float) -> _Rates:
        return self._forced(self._contacts_at(frame, BodyState(x, y, psi, vx, vy, w)), w)

    def _contacts_at(self, frame: PalmFrame, q: BodyState) -> _BothContacts:
        one, two = (
            self._contact(frame, q, *palm) if on else None for on, palm in zip(self.touching, frame.each(), strict=True)
        )
        return one, two

    def _contact(
        self, frame: PalmFrame, q: BodyState, tx: float, ty: float, out: float, turn: float, alpha: float, above: float
    ) -> _Rubbing:
        rx, ry, ux, uy = q.x - frame.ox, q.y - frame.oy, q.vx - frame.vox, q.vy - frame.voy
        gx, gy, w = -frame.aox, -self._gravity_now() - frame.aoy, q.omega0
        damping = -self.surface.damping * w / self.body.rho**2
        h, slope, bend = self.body.support.at(out - q.psi)
        spin, along, over = turn - w, tx * rx + ty * ry, tx * ry - ty * rx
        going, rising = tx * ux + ty * uy, tx * uy - ty * ux
        rate, slip = rising - turn * along - slope * spin, going + w * h + turn * (over - h)
        fall = (
            tx * gy - ty * gx - 2.0 * turn * going - alpha * along - turn * turn * over - bend * spin * spin
            - slope * (alpha - damping) + _DRIFT_RATE * (2.0 * rate + _DRIFT_RATE * (over - h - above))
        )  # fmt: skip
        drag = (
            tx * gx + ty * gy + turn * rising + w * slope * spin + h * damping + alpha * (over - h)
            + turn * rate + _DRIFT_RATE * slip
        )  # fmt: skip
        return _Rubbing(tx, ty, h, slope, fall, drag, slip)

    def _forced(self, contacts: _BothContacts, w: float) -> _Rates:
        """Accelerations and normal forces by γ̈ = 0 at each contact and, at the one that is held, a slip that stays 0.

        Leaves the friction that this asks for in `_ratios`.
        """
        rho2 = self.body.rho**2
        held = contacts[self._held] if self._held is not None else None
        one, two = (self._push(at, 0.0 if at is held else k) for at, k in zip(contacts, self._ratios, strict=True))
        a11, a12, b1 = self._row(contacts[0], one, two, held) if contacts[0] else (1.0, 0.0, 0.0)
        a21, a22, b2 = self._row(contacts[1], one, two, held) if contacts[1] else (0.0, 1.0, 0.0)
        det = a11 * a22 - a12 * a21
        f1, f2 = (a12 * b2 - a22 * b1) / det, (a21 * b1 - a11 * b2) / det
        ax, ay = f1 * one.fx + f2 * two.fx, f1 * one.fy + f2 * two.fy
        al = (f1 * one.torque + f2 * two.torque) / rho2
        if held is not None and self._held is not None:
            rubbed = (held.drag + held.tx * ax + held.ty * ay + held.h * al) / (1.0 + held.h * held.h / rho2)
            ax, ay, al = ax - rubbed * held.tx, ay - rubbed * held.ty, al - rubbed * held.h / rho2
            force = f2 if self._held else f1
            self._ratios[self._held] = rubbed / force if force > 0.0 else math.copysign(math.inf, rubbed)
        return ax, ay - self._gravity_now(), al - self.surface.damping * w / rho2, f1, f2

    def _push(self, at: _Rubbing | None, ratio: float) -> _Push:
        if at is None:
            return _Push(0.0, 0.0, 0.0)
        return _Push(-at.ty - ratio * at.tx, at.tx - ratio * at.ty, at.slope - ratio * at.h)

    def _row(self, at: _Rubbing, one: _Push, two: _Push, held: _Rubbing | None) -> tuple[float, float, float]:
        """What a unit of each normal force does to the contact's gap, with what is held; and what does the rest."""
        rho2 = self.body.rho**2
        a1, a2 = (at.tx * by.fy - at.ty * by.fx + at.slope * by.torque / rho2 for by in (one, two))
        if held is None:
            return a1, a2, at.fall
        share = at.tx * held.ty - at.ty * held.tx + at.slope * held.h / rho2
        share /= 1.0 + held.h * held.h / rho2
        b1, b2 = (held.tx * by.fx + held.ty * by.fy + held.h * by.torque / rho2 for by in (one, two))
        return a1 - share * b1, a2 - share * b2, at.fall - share * held.drag

    def _slip_rates(self, contacts: _BothContacts, rates: _Rates) -> tuple[float, float]:
        """d(slip)/dt at both contacts (m/s²) under these accelerations."""
        ax, ay, al, _, _ = rates
        ay += self._gravity_now()
        al += self.surface.damping * self.state.omega0 / self.body.rho**2
        one, two = (
            at.drag - _DRIFT_RATE * at.slip + at.tx * ax + at.ty * ay + at.h * al if at else 0.0 for at in contacts
        )
        return one, two


def _until_one_stops(before: tuple[float, float], after: tuple[float, float]) -> float:
    """The share of a step after which the first of the slips has come to zero; 1 where none turns round."""
    return min(
        (u / (u - v) for u, v in zip(before, after, strict=True) if abs(u) > _STOPPED and u * v < 0.0), default=1.0
    )
