"""Published quantities: topics, their fields, and how they are displayed; for two palms, and common to all systems.

Messages, `palmd top`, the live page, reports, exports, the layouts in `config/` and docs/reference/messages.md take
names, units, symbols and rates from here. To add a quantity, add a row and fill it in where the message is built.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from palmd.aliases import aliases_of
from palmd.events import DECIDED
from palmd.system.mechanism import ENDS, JOINT_MEANINGS, PALMS
from palmd.system.naming import PAD_NUMBERS
from palmd.system.rig_constants import RIG_TABLE

SCHEMA = 1

Kind = Literal["number", "bool", "text", "numbers", "texts", "sds"]
Role = Literal["plain", "derived", "named"]
Tab = Literal["state", "trust", "forces", "loop"]

LEAST_STALE_S = 0.5
STALE_PERIODS = 3.0


@dataclass(frozen=True, slots=True)
class Shown:
    """How a number is displayed: its unit, the factor from the published unit, and the number of decimals."""

    unit: str
    factor: float
    digits: int


_SHOWN = {
    "m": Shown("mm", 1e3, 2),
    "rad": Shown("°", math.degrees(1), 1),
    "rad/s": Shown("°/s", math.degrees(1), 1),
    "kg": Shown("g", 1e3, 1),
    "N": Shown("N", 1.0, 2),
}


@dataclass(frozen=True, slots=True)
class Chart:
    """Quantities drawn in one chart: those whose `chart` has this name.

    As a strip of the live page, in the `group`, its axis spans at least `span` displayed units, from `low` on if given;
    without a span the page has no strip of it. good: range in displayed units in which all is well.
    """

    name: str
    tab: Tab
    title: str
    span: float | None = None
    low: float | None = None
    group: str = ""
    good: tuple[float, float] | None = None


NIS_BAND = (0.4, 1.5)
"""Range of the mean NIS of a consistent observer: 2 % of readings wrong by centimetres raise it from 1 to 1.3."""

_OBJECT, _PALMS, _TRUST = "Object", "Palms", "Trust"


CHARTS = (
    Chart("distance", "state", "Distance of the palms from the centre of mass", 0.5, group=_OBJECT),
    Chart("rate", "state", "Angular rate of the object", 10.0, group=_OBJECT),
    Chart("place", "state", "Centre of mass from the apex", 2.0, group=_OBJECT),
    Chart("contact", "state", "Contacts, from the hinge", 2.0, group=_OBJECT),
    Chart("gyration", "state", "Radius of gyration", 1.0, group=_OBJECT),
    Chart("angles", "state", "Palm angles", 4.0, group=_PALMS),
    Chart("rates", "state", "Palm rates", 4.0, group=_PALMS),
    Chart("turn", "state", "Turn of the object"),
    Chart("nis", "trust", "Normalised innovation squared: 1 when readings and model agree", 1.0, 0.0, _TRUST, NIS_BAND),
    Chart("observability", "trust", "Observability: above 1 if the last second determines the state", 1.0, 0.0, _TRUST,
          (1.0, math.inf)),
    Chart("touched", "trust", "Touched, valid"),
    Chart("object", "trust", "Number of the object"),
    Chart("force", "forces", "Normal force", 0.5, 0.0, _PALMS),
    Chart("mass", "forces", "Mass"),
    Chart("friction", "forces", "Friction"),
    Chart("pressure", "forces", "Pressure of the pads, counts"),
    Chart("lateness", "loop", "Lateness"),
    Chart("work", "loop", "Work"),
    Chart("age", "loop", "Age of the readings"),
    Chart("missed", "loop", "Ticks skipped, readings dropped"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Quantity:
    """One published field; a name that ends in `*` stands for every name with that prefix.

    unit: as published, empty for none. role: `derived` has a standard deviation in the message's `sd`; `named` must
    also be finite, with its standard deviation, in a valid estimate. chart: name of its `Chart`. source: the attribute
    that it is taken from, SI. glance: whether it is in the summary of an estimate. palm: number of its palm, else 0.
    digits: decimals, if other than the unit's.
    """

    name: str
    kind: Kind
    unit: str
    meaning: str
    symbol: str = ""
    chart: str = ""
    role: Role = "plain"
    source: str = ""
    glance: bool = False
    palm: int = 0
    digits: int | None = None

    @property
    def uncertain(self) -> bool:
        """Whether it has a standard deviation."""
        return self.role != "plain"

    @property
    def shown(self) -> Shown:
        """How it is displayed."""
        shown = _SHOWN.get(self.unit, Shown(self.unit, 1.0, 3))
        return shown if self.digits is None else replace(shown, digits=self.digits)

    @property
    def label(self) -> str:
        """Symbol and displayed unit, for an axis."""
        return f"{self.symbol} ({self.shown.unit})" if self.shown.unit else self.symbol


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: its rate, and its quantities in addition to those of `STAMP`.

    rate_hz: at the default loop rate if published every tick; 0 for no fixed rate. when: addition to the rate.
    """

    name: str
    rate_hz: float
    when: str
    quantities: tuple[Quantity, ...]

    @property
    def frame(self) -> bytes:
        """The first frame of its messages."""
        return self.name.encode()

    @property
    def rate(self) -> str:
        """The rate in words."""
        return ", ".join(filter(None, (f"{self.rate_hz:g} Hz" if self.rate_hz else "", self.when)))

    @property
    def stale_s(self) -> float:
        """Age (s) of the last message above which it is displayed as stale; infinite without a rate."""
        return max(LEAST_STALE_S, STALE_PERIODS / self.rate_hz) if self.rate_hz else math.inf

    def __getitem__(self, name: str) -> Quantity:
        """The quantity of that name; raises KeyError."""
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity
        raise KeyError(f"{self.name} has no {name}")

    def with_former_names(self) -> Topic:
        """The same with a quantity for each former name of one."""
        rows = (
            replace(self[standard], name=former, meaning=f"former name of `{standard}`, until 2.0", source="")
            for _, standard, former, _ in aliases_of(self.name)
        )
        return replace(self, quantities=(*self.quantities, *rows))


def drawn(topic: Topic, *, tab: Tab | None = None, chart: str | None = None) -> Iterator[Quantity]:
    """The quantities of a topic that are drawn, chart by chart: all, those of a tab, or those of a chart."""
    for each in CHARTS:
        if tab in (None, each.tab) and chart in (None, each.name):
            yield from (quantity for quantity in topic.quantities if quantity.chart == each.name)


def following(unit: str) -> tuple[Quantity, Quantity]:
    """The following error of all joints, and its limit."""
    return (
        Quantity(f"following_error_{unit}", "numbers", unit,
                 "actual minus delayed set-point of each joint at the last report; NaN where not judged"),
        Quantity(f"following_limit_{unit}", "numbers", unit, "limit of each joint; NaN where not judged"),
    )  # fmt: skip


def of_each_palm(*rows: Quantity) -> Iterator[Quantity]:
    """The rows for each palm in turn: `{}` is its number, `{sub}` a subscript, `{angle}` its joint in words."""
    for palm, angle in zip(PALMS, JOINT_MEANINGS, strict=True):
        for row in rows:
            texts = {name: getattr(row, name) for name in ("name", "meaning", "symbol", "source")}
            sub = chr(ord("₀") + palm)
            yield replace(
                row, palm=palm, **{name: text.format(palm, sub=sub, angle=angle) for name, text in texts.items()}
            )


STAMP = (
    Quantity("v", "number", "", "schema version"),
    Quantity("timestamp", "number", "s", "Unix time of sending"),
    Quantity("mono_ns", "number", "ns", "CLOCK_MONOTONIC of the tick to which the values refer"),
    Quantity("seq", "number", "", "increases by one with every message of the topic"),
)

ESTIMATE = Topic(
    "palm/estimate",
    100.0,
    "every tick",
    (
        Quantity("invalid_reasons", "texts", "", "codes of the reasons why it is invalid, empty when valid",
                 source="invalid_reasons"),
        Quantity("valid", "bool", "", "whether it passed all tests: settled, consistent, finite", "valid", "touched",
                 source="valid"),
        Quantity("observer", "text", "", "the observer that made the estimate", source="observer"),
        Quantity("object", "number", "", "increases when a new object is started", "object", "object",
                 source="object_count"),
        *of_each_palm(Quantity("r{}_m", "number", "m", "distance of palm {} from the centre of mass",
                               "r{sub}", "distance", "named", "r{}", glance=True)),
        Quantity("omega0_rad_s", "number", "rad/s", "angular rate of the object",
                 "ω₀", "rate", "named", "omega0", glance=True),
        *of_each_palm(Quantity("s{}_m", "number", "m", "contact on palm {}, from the hinge",
                               "s{sub}", "contact", "named", "s{}", glance=True)),
        *of_each_palm(
            Quantity("phi{}_rad", "number", "rad", "{angle}", "φ{sub}", "angles", "named", "phi{}"),
            Quantity("omega{}_rad_s", "number", "rad/s", "rate of phi{}", "ω{sub}", "rates", "named", "omega{}"),
        ),
        Quantity("rho_m", "number", "m", "radius of gyration", "ρ", "gyration", "named", "rho", glance=True),
        Quantity("psi_rad", "number", "rad",
                 "rotation of the object since the first fused measurement, or relative to a stored outline",
                 "ψ", "turn", "named", "psi", glance=True),
        *of_each_palm(Quantity("v{}_m", "number", "m", "radius of curvature of the outline at contact {}",
                               "v{sub}", "", "derived", "v{}")),
        Quantity("mu", "number", "", "friction", "μ", "friction", "derived", "mu", glance=True),
        Quantity("mass_kg", "number", "kg", "mass of the object", "m", "mass", "derived", "mass", glance=True),
        *of_each_palm(Quantity("f{}_n", "number", "N", "normal force of contact {}",
                               "f{sub}", "force", "derived", "f{}", glance=True)),
        Quantity("com_x_m", "number", "m", "centre of mass, world frame", "x", "", "derived", "com_x"),
        Quantity("com_y_m", "number", "m", "centre of mass, world frame", "y", "", "derived", "com_y", glance=True),
        Quantity("sd", "sds", "", "standard deviation of each field that it names, in that field's unit"),
        Quantity("nis", "number", "", "normalised innovation squared, running mean", "NIS", "nis", source="nis",
                 digits=2),
        Quantity("observability", "number", "", "smallest singular value, scaled", "observability", "observability",
                 source="observability", digits=2),
        Quantity("touched", "number", "", "fraction of normals that have been in contact", "touched", "touched",
                 source="touched"),
        Quantity("e_f_m", "number", "m", "error of balance (3.36), of the quasistatic observer", source="e_f"),
        Quantity("e_c_m", "number", "m", "error of contact (3.37), of the quasistatic observer", source="e_c"),
    ),
)  # fmt: skip
SHAPE = Topic(
    "palm/shape",
    10.0,
    "at most",
    (
        Quantity("theta_rad", "numbers", "rad", "direction of the outward normal in the object's frame"),
        Quantity("h_m", "numbers", "m", "support function about the centre of mass"),
        Quantity("h_sd_m", "numbers", "m", "standard deviation of h"),
        Quantity("touched", "numbers", "", "1 where a palm has been in contact, else 0"),
    ),
)
OBJECT = Topic(
    "palm/object",
    10.0,
    "at most, only with stored outlines",
    (
        Quantity("names", "texts", "", "names of the stored outlines"),
        Quantity("probability", "numbers", "", "probability of each of them"),
        Quantity("none", "number", "", "probability of none of them"),
        Quantity("best", "text", "", f"the name whose probability is at least {DECIDED:g}, empty if there is none"),
        Quantity("object", "number", "", "as in palm/estimate"),
    ),
)
CONTACT = Topic(
    "palm/contact",
    100.0,
    "every tick",
    (
        *of_each_palm(Quantity("s{}_m", "number", "m", "last reading of pad {}, from the hinge; NaN while untouched",
                               chart="contact")),
        *of_each_palm(Quantity("pressure{}", "number", "", "last pressure of pad {}, counts", chart="pressure")),
        *of_each_palm(Quantity("age{}_ms", "number", "ms", "age of pad {}'s last packet", "pad {}", "age", digits=0)),
        Quantity("arm_age_ms", "number", "ms", "age of the arm's last report", "arm", "age", digits=0),
        *of_each_palm(Quantity("touch{}", "bool", "", "whether pad {} is touched")),
        *of_each_palm(Quantity("batch{}", "bool", "", "whether pad {}'s last packet was read together with others")),
    ),
)  # fmt: skip
FOLLOWING_RAD = following("rad")
MOTION = Topic(
    "palm/motion",
    100.0,
    "every tick",
    (
        *of_each_palm(Quantity("phi{}_cmd_rad", "number", "rad", "commanded; NaN unless tracking",
                               "φ{sub}", "angles", digits=2)),
        *of_each_palm(Quantity("phi{}_rad", "number", "rad", "actual, from the arm's last report", "φ{sub}", digits=2)),
        Quantity("plan", "text", "", "name of the plan, empty without one"),
        Quantity("segment", "number", "", "number of the plan's segment from 0; -1 when no plan is being run"),
        Quantity("progress", "number", "",
                 "of the plan, 0 to 1; of the round if it repeats forever, of the coverage if it explores"),
        Quantity("arm_state", "text", "", "the controller's state letter, empty while unknown"),
        *FOLLOWING_RAD,
    ),
)  # fmt: skip
STATE = Topic(
    "palm/state",
    10.0,
    "and on change",
    (
        Quantity("state", "text", "", "idle, ready, tracking, hold or fault"),
        Quantity("faults", "texts", "", "codes of the active faults, latched ones included"),
        Quantity("severities", "texts", "", "note, degrade, hold or stop, one for each fault"),
        Quantity("hints", "texts", "", "what to do, one for each fault"),
        Quantity("texts", "texts", "", "description, one for each fault"),
        Quantity("cause", "text", "", "what caused the state, in words; empty if it has not changed since the start"),
        Quantity("requested_state", "text", "", "hold or stop, from its request until arm, start or reset; else empty"),
        Quantity("control", "text", "", "the client that has control of the rig; empty for none"),
        Quantity(
            "unattended", "bool", "", "whether a plan moves the palms while no client with a declared lease has control"
        ),
        Quantity("since_s", "number", "s", "time in this state"),
        Quantity("running", "bool", "", "whether a plan is running; false if it is held or complete"),
        Quantity(
            "exploring",
            "bool",
            "",
            "whether an exploration is under way; the following fields refer to it, else to the last one",
        ),
        Quantity("explored_s", "number", "s", "its duration without holds; NaN before the first"),
        Quantity("coverage", "number", "", "fraction touched of the reachable normals; NaN while unknown"),
        Quantity("coverage_goal", "number", "", "the coverage at which it is complete"),
        Quantity("reachable", "number", "", "reachable fraction of all normals; NaN while unknown"),
        Quantity("reason", "text", "", "why it waits or has ended, in words; empty while it proceeds"),
    ),
).with_former_names()
LOOP = Topic(
    "palm/loop",
    1.0,
    "",
    (
        Quantity("ticks", "number", "", "ticks since the start"),
        Quantity("overruns", "number", "", "ticks skipped since the start because another tick took too long",
                 chart="missed"),
        *(
            Quantity(f"{what}_{part}_ms", "number", "ms", f"{meaning}, {words} of the last second", part, what,
                     digits=2)
            for what, meaning in (("lateness", "how late a tick began"), ("work", "how long a tick took"))
            for part, words in (("p50", "median"), ("p99", "99th percentile"), ("max", "largest"))
        ),
        Quantity("lateness_ms", "numbers", "ms", "how late each tick of the last second began, in order"),
        *(
            Quantity(f"{port}_*", "number", "", f"counts on the {port} port since the start, by kind")
            for port in dict.fromkeys((*ENDS, *(f"pad{number}" for number in PAD_NUMBERS)))
        ),
        Quantity("bus_*", "number", "", "counts on the bus since the start"),
        Quantity("lag_ms", "number", "ms", "estimated delay of the arm behind its set-points"),
        Quantity("late_dropped", "number", "", "samples too late for the observer since the start", chart="missed"),
        Quantity("smoother_*", "number", "",
                 "since the start: improvements used, starts of its process, readings lost"),
        Quantity("explorer_*", "number", "",
                 "since the start: starts of its process, decisions that came too late"),
        Quantity("rss_mb", "number", "MB", "resident memory", digits=0),
        Quantity("blocks", "number", "", "live memory blocks of the interpreter; steady growth indicates a leak"),
        Quantity("backend", "text", "", "backend of the models: c, vm or numpy"),
    ),
)  # fmt: skip


def runtime_quantities(system: str = "") -> tuple[Quantity, ...]:
    """The first fields of every system's info; two palms do not name themselves."""
    return (
        Quantity("version", "text", "", "of palmd"),
        Quantity("schema", "number", "", "of these messages"),
        *((Quantity("system", "text", "", system),) if system else ()),
        Quantity("config_hash", "text", "", "sha256 of the effective configuration"),
        Quantity("observer", "text", "", "the observer that runs"),
        Quantity("rate_hz", "number", "Hz", "of the ticks"),
        Quantity("units", "text", "", "where the units are"),
    )


AVAILABLE_PLANS = Quantity(
    "plans", "texts", "", "the plans in the folder of the configured one, as the plan command takes them"
)
INFO = Topic(
    "palm/info",
    1.0,
    "",
    (
        *runtime_quantities(),
        Quantity("hinge", "text", "", "kind of hinge between the palms: arc or fixed"),
        Quantity("gravity_m_s2", "number", "m/s²", "in the plane of the palms"),
        Quantity(
            "base_m",
            "numbers",
            "m",
            f"far end of palm {PALMS[0]}, at which an arc hinge is fixed: x and y, world frame",
        ),
        *of_each_palm(Quantity("palm{}_length_m", "number", "m", "palm {}, from the hinge to its far end")),
        *of_each_palm(Quantity("pad{}_length_m", "number", "m", "pad {}, from the hinge on")),
        *of_each_palm(Quantity("phi{}_limits_rad", "numbers", "rad", "least and largest phi{}")),
        *of_each_palm(
            Quantity("palm{}_curvature_per_m", "number", "1/m", "curvature of palm {}: > 0 concave, 0 flat, < 0 convex")
        ),
        Quantity("palms", "numbers", "", "the palms' numbers, as in the names of their quantities"),
        Quantity(
            "joints", "texts", "", "name of the joint that turns each palm against the one before, as in <joint>_rad"
        ),
        Quantity("sides", "numbers", "", "side of the object, seen along each palm from the hinge: 1 left, -1 right"),
        AVAILABLE_PLANS,
        Quantity("rate_limit_rad_s", "number", "rad/s", "of each palm angle"),
        Quantity("acceleration_limit_rad_s2", "number", "rad/s²", "of each palm angle"),
        Quantity("force_limit_n", "numbers", "N", "largest force allowed on each pad, palm by palm"),
    ),
)
TICK = Quantity("t_tick_s", "number", "s", "the tick's time, CLOCK_MONOTONIC, bit for bit")
EVENTS = Topic(
    "palm/events",
    100.0,
    "every tick",
    (
        TICK,
        Quantity(
            "source",
            "numbers",
            "",
            "of each event fed to the observer, in this order: 1 or 2 a reading of that pad, -1 or -2 the end "
            "of its contact, 0 the palms",
        ),
        Quantity("t_sample_s", "numbers", "s", "time of measurement, CLOCK_MONOTONIC"),
        Quantity("s_m", "numbers", "m", "of a reading: contact, from the hinge"),
        Quantity("force_n", "numbers", "N", "of a reading: normal force"),
        *of_each_palm(Quantity("phi{}_rad", "numbers", "rad", "of the palms: phi{} as measured")),
        *of_each_palm(Quantity("omega{}_rad_s", "numbers", "rad/s", "of the palms: rate of phi{}, planned")),
        *of_each_palm(Quantity("alpha{}_rad_s2", "numbers", "rad/s²", "of the palms: acceleration of phi{}, planned")),
    ),
)
IMPROVEMENT = Topic(
    "palm/improvement",
    0.0,
    "when the smoother beside the loop has answered",
    (
        TICK,
        Quantity("t_s", "number", "s", "time to which the answer refers, CLOCK_MONOTONIC", source="t"),
        Quantity("x", "numbers", "SI", "mean of the shape map's state", source="x"),
        Quantity("covariance", "numbers", "SI", "covariance of that state given `rig`, row by row", source="P"),
        Quantity("frame", "number", "", "changes when the outline's gauge changes",
                 source="frame"),
        Quantity("established", "bool", "", "whether it is confirmed for so long that no rival hypothesis is kept",
                 source="established"),
        Quantity("touched", "numbers", "", "0 or 1 for each of 72 bins of outward normals, the first beginning at 0",
                 source="touched"),
        Quantity("rig", "numbers", "SI", "errors of the rig constants, in the order of `palm/rig`",
                 source="rig"),
        Quantity("rig_sd", "numbers", "SI", "standard deviation of each", source="rig_sd"),
        Quantity("spread", "numbers", "SI", "change due to independent 1σ steps of `rig`: of the state, then of `rig`",
                 source="spread"),
        Quantity("contradicted", "numbers", "", "number of σ by which the readings contradict each of `rig`, or 0",
                 source="contradicted"),
    ),
)  # fmt: skip
UNEXPLAINED = Topic(
    "palm/unexplained",
    0.0,
    "when the smoother beside the loop finds no outline that explains the readings",
    (TICK, Quantity("t_s", "number", "s", "time of the last of those readings, CLOCK_MONOTONIC")),
)
RIG = Topic(
    "palm/rig",
    1.0,
    "and when the smoother beside the loop has answered",
    (
        *(Quantity(constant.name, "number", constant.unit, constant.meaning, role="derived") for constant in RIG_TABLE),
        Quantity("sd", "sds", "", "standard deviation of each; that of the configuration until readings determine it"),
        Quantity(
            "prior_sd",
            "numbers",
            "SI",
            "prior standard deviation of each by the configuration, in the order of these rows",
        ),
        Quantity("contradictions", "texts", "",
                 "in words: errors of the rig that the readings determine beyond doubt, and what to do"),
    ),
).with_former_names()  # fmt: skip
LOG_ENTRIES = 100
LOG = Topic(
    "palm/log",
    1.0,
    "and with each new entry, 10 Hz at most",
    (
        Quantity("number", "numbers", "",
                 f"number of each of the last {LOG_ENTRIES} entries, in order, from 0 since the daemon's start"),
        Quantity("t_s", "numbers", "s", "time of the event, CLOCK_MONOTONIC"),
        Quantity(
            "kind",
            "texts",
            "",
            "its subject: palmd, state, fault, command, control, plan, exploration, object, rig, recorder",
        ),
        Quantity("name", "texts", "",
                 "the new state, the code of the fault, the command; else begun, over, stopping, known, lost …"),
        Quantity("severity", "texts", "", "of a fault: note, degrade, hold or stop; else empty"),
        Quantity("who", "texts", "", "the client that gave the command; else empty"),
        Quantity("lasted_s", "numbers", "s", "duration of something that ended; else NaN"),
        Quantity("text", "texts", "", "in words, with the cause: which byte, which age, which limit"),
        Quantity("code", "texts", "",
                 "of a fault of a line: mute, unreadable, foreign; of the controller: its error; else empty"),
    ),
)  # fmt: skip
NOTE = Topic(
    "palm/note",
    0.0,
    "when a note is written",
    (
        Quantity("t_s", "number", "s", "when it was written, CLOCK_MONOTONIC"),
        Quantity("text", "text", "", "the note about this time of the run"),
    ),
)
CONFIG = Topic(
    "palm/config",
    1.0,
    "",
    (
        Quantity("config_hash", "text", "", "sha256 of the effective configuration, as in palm/info"),
        Quantity("yaml", "text", "", "the effective configuration, defaults included"),
    ),
)
"""Kept by a recorder, whatever configuration it was started with."""

TRUTH = Topic(
    "rig/truth",
    100.0,
    "",
    (
        *(
            replace(ESTIMATE[name], chart="", role="plain", source="", glance=False)
            for name in (
                "psi_rad",
                "omega0_rad_s",
                *(name.format(palm) for name in ("r{}_m", "s{}_m", "phi{}_rad", "omega{}_rad_s") for palm in PALMS),
                "com_x_m",
                "com_y_m",
                *map("f{}_n".format, PALMS),
            )
        ),
        *of_each_palm(Quantity("contact{}", "bool", "", "whether the object touches palm {}")),
        Quantity("object", "number", "", "increases when another object is put on the palms"),
        Quantity("arm_state", "text", "", "the controller's state letter"),
    ),
)  # fmt: skip
BODY = Topic(
    "rig/object",
    1.0,
    "",
    (
        Quantity("object", "number", "", "as in rig/truth"),
        Quantity("kind", "text", "", "kind of the object drawn"),
        Quantity("shape", "text", "", "composition of the outline"),
        Quantity("theta_rad", "numbers", "rad", "direction of the outward normal in a frame that turns by psi_rad"),
        Quantity("h_m", "numbers", "m", "support function about the centre of mass"),
        *(
            replace(ESTIMATE[name], chart="", role="plain", source="", glance=False)
            for name in ("rho_m", "mass_kg", "mu")
        ),
        Quantity("dither_m_s", "number", "m/s", "dither speed u_d of the friction law"),
        Quantity("damping_m2_s", "number", "m²/s", "viscous damping of its rotation, per unit mass"),
    ),
)
REPLAY = Topic(
    "replay/run",
    1.0,
    "",
    (
        Quantity("path", "text", "", "the recorded run that is being published again"),
        Quantity("speed", "number", "", "times the recorded pace"),
    ),
)
"""Published by `palmd replay` in addition, so that an old run is not mistaken for a live one."""

STALL = Topic(
    "rig/stall",
    0.0,
    "when it has stalled for more than 20 ms for lack of processor time",
    (
        Quantity("t_s", "number", "s", "end of the stall, CLOCK_MONOTONIC"),
        Quantity("lasted_s", "number", "s", "duration in which the emulated rig sent nothing; real rigs do not stall"),
        Quantity("count", "number", "", "number of stalls since its start"),
    ),
)


@dataclass(frozen=True, slots=True)
class SystemTopics:
    """The topics of a system: those that every system has, and its own in `extra`."""

    estimate: Topic
    shape: Topic
    contact: Topic
    motion: Topic
    events: Topic
    info: Topic
    truth: Topic
    """True motion, published by its emulated rig; `body` is the true object."""
    body: Topic
    extra: tuple[Topic, ...] = ()

    @property
    def published(self) -> tuple[Topic, ...]:
        """Topics of the daemon."""
        return self.estimate, self.shape, self.contact, self.motion, self.events, *self.extra, self.info


TWO_PALMS_TOPICS = SystemTopics(
    ESTIMATE, SHAPE, CONTACT, MOTION, EVENTS, INFO, TRUTH, BODY, (OBJECT, IMPROVEMENT, UNEXPLAINED)
)

UNITS = "SI; each name ends in its unit: _m _m2 _rad _rad_s _kg _kg_m _n _s _ms _ns _hz _mb _m_per_n"
