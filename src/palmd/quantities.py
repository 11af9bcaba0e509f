"""What is published: topics, their quantities, and how people are shown them; those of two palms, and of every system.

Messages, `palmd top`, the live page, reports, exports, the layouts in `config/` and docs/reference/messages.md take
names, units, symbols and rates from here. Adding a quantity is adding a row, and filling it in where it is built.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

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
    """How people read a number: its unit, how many of these are one published unit, digits behind the point."""

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
    """Quantities that are drawn in one picture, those whose `chart` has this name.

    As a strip of the live page, in the `group`, its axis spans at least `span` shown units, from `low` on where that is
    given; without a span the page has no strip of it. good: from where to where, in shown units, all is well.
    """

    name: str
    tab: Tab
    title: str
    span: float | None = None
    low: float | None = None
    group: str = ""
    good: tuple[float, float] | None = None


NIS_BAND = (0.4, 1.5)
"""Where the mean of an honest observer's NIS lies: 2 % of readings wrong by centimetres bring an honest 1 to 1.3."""

_ON_IT, _PALMS, _TRUST = "Object", "Palms", "Trust"


CHARTS = (
    Chart("distance", "state", "Distance of the palms from the centre of mass", 0.5, group=_ON_IT),
    Chart("rate", "state", "Angular rate of the object", 10.0, group=_ON_IT),
    Chart("place", "state", "Centre of mass from the apex", 2.0, group=_ON_IT),
    Chart("contact", "state", "Contacts, from the hinge", 2.0, group=_ON_IT),
    Chart("gyration", "state", "Radius of gyration", 1.0, group=_ON_IT),
    Chart("angles", "state", "Palm angles", 4.0, group=_PALMS),
    Chart("rates", "state", "Palm rates", 4.0, group=_PALMS),
    Chart("turn", "state", "Turn of the object"),
    Chart("nis", "trust", "Normalised innovation squared: 1 when readings and model agree", 1.0, 0.0, _TRUST, NIS_BAND),
    Chart("observability", "trust", "Observability: above 1 when the last second alone tells all", 1.0, 0.0, _TRUST,
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
    """One published field; a name that ends in `*` stands for every name so begun.

    unit: as published, empty for what has none. role: `derived` has a one-sigma in the message's `sd`, `named` must
    besides be finite, one-sigma included, in an estimate that says `valid`. chart: name of the `Chart` it is drawn in.
    source: the attribute of what it is taken from, SI. glance: whether it is among the few that are shown at a glance.
    palm: its number for what belongs to one palm, else 0. digits: where its unit's are not enough or too many.
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
        """Whether it has a one-sigma."""
        return self.role != "plain"

    @property
    def shown(self) -> Shown:
        """How people read it."""
        shown = _SHOWN.get(self.unit, Shown(self.unit, 1.0, 3))
        return shown if self.digits is None else replace(shown, digits=self.digits)

    @property
    def label(self) -> str:
        """Symbol and unit shown, as an axis has them."""
        return f"{self.symbol} ({self.shown.unit})" if self.shown.unit else self.symbol


@dataclass(frozen=True, slots=True)
class Topic:
    """One topic: how often it comes, and its quantities beyond those of `STAMP`.

    rate_hz: at the default rate of the loop where it is every tick; 0 for what has no rate. when: what the rate leaves
    unsaid.
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
        """How often it comes, in words."""
        return ", ".join(filter(None, (f"{self.rate_hz:g} Hz" if self.rate_hz else "", self.when)))

    @property
    def stale_s(self) -> float:
        """How old (s) its last message may be before people are told; infinite without a rate."""
        return max(LEAST_STALE_S, STALE_PERIODS / self.rate_hz) if self.rate_hz else math.inf

    def __getitem__(self, name: str) -> Quantity:
        """The quantity of that name; raises KeyError."""
        for quantity in self.quantities:
            if quantity.name == name:
                return quantity
        raise KeyError(f"{self.name} has no {name}")


def drawn(topic: Topic, *, tab: Tab | None = None, chart: str | None = None) -> Iterator[Quantity]:
    """The quantities of a topic that are drawn, chart by chart: all, those of a tab, or those of a chart."""
    for each in CHARTS:
        if tab in (None, each.tab) and chart in (None, each.name):
            yield from (quantity for quantity in topic.quantities if quantity.chart == each.name)


def following(unit: str) -> tuple[Quantity, Quantity]:
    """The following error of all joints, and its limit."""
    return (
        Quantity(f"following_error_{unit}", "numbers", unit,
                 "actual less delayed set-point of each joint at the last report; NaN where not judged"),
        Quantity(f"following_limit_{unit}", "numbers", unit, "of each joint, where the arm is stopped; NaN likewise"),
    )  # fmt: skip


def of_each_palm(*rows: Quantity) -> Iterator[Quantity]:
    """The rows for one palm after the other: `{}` is its number, `{sub}` a small one, `{angle}` its joint in words."""
    for palm, angle in zip(PALMS, JOINT_MEANINGS, strict=True):
        for row in rows:
            texts = {name: getattr(row, name) for name in ("name", "meaning", "symbol", "source")}
            sub = chr(ord("₀") + palm)
            yield replace(
                row, palm=palm, **{name: text.format(palm, sub=sub, angle=angle) for name, text in texts.items()}
            )


STAMP = (
    Quantity("v", "number", "", "schema version"),
    Quantity("timestamp", "number", "s", "Unix time when it was sent"),
    Quantity("mono_ns", "number", "ns", "CLOCK_MONOTONIC of the tick that the values hold for"),
    Quantity("seq", "number", "", "counts up by one with every message of the topic"),
)

ESTIMATE = Topic(
    "palm/estimate",
    100.0,
    "every tick",
    (
        Quantity("invalid_reasons", "texts", "", "codes of what speaks against it, empty when valid",
                 source="invalid_reasons"),
        Quantity("valid", "bool", "", "whether to trust it: settled, consistent, finite", "valid", "touched",
                 source="valid"),
        Quantity("observer", "text", "", "which observer it comes from", source="observer"),
        Quantity("object", "number", "", "counts up when a new object is begun", "object", "object",
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
                 "turn of the object since the first fused measurement, or from a stored outline",
                 "ψ", "turn", "named", "psi", glance=True),
        *of_each_palm(Quantity("v{}_m", "number", "m", "radius of curvature of the outline at contact {}",
                               "v{sub}", "", "derived", "v{}")),
        Quantity("mu", "number", "", "friction", "μ", "friction", "derived", "mu", glance=True),
        Quantity("mass_kg", "number", "kg", "mass of the object", "m", "mass", "derived", "mass", glance=True),
        *of_each_palm(Quantity("f{}_n", "number", "N", "normal force of contact {}",
                               "f{sub}", "force", "derived", "f{}", glance=True)),
        Quantity("com_x_m", "number", "m", "centre of mass, world frame", "x", "", "derived", "com_x"),
        Quantity("com_y_m", "number", "m", "centre of mass, world frame", "y", "", "derived", "com_y", glance=True),
        Quantity("sd", "sds", "", "one-sigma of each field that it names, in that field's unit"),
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
        Quantity("h_sd_m", "numbers", "m", "one-sigma of h"),
        Quantity("touched", "numbers", "", "1 where a palm has been in contact, else 0"),
    ),
)
OBJECT = Topic(
    "palm/object",
    10.0,
    "at most, only with stored outlines",
    (
        Quantity("names", "texts", "", "of the stored outlines"),
        Quantity("probability", "numbers", "", "that it is the object of that name, one for each"),
        Quantity("none", "number", "", "probability that it is none of them"),
        Quantity("best", "text", "", f"the name whose probability is at least {DECIDED:g}, empty when none is"),
        Quantity("object", "number", "", "as in palm/estimate"),
    ),
)
CONTACT = Topic(
    "palm/contact",
    100.0,
    "every tick",
    (
        *of_each_palm(Quantity("s{}_m", "number", "m", "last reading of pad {}, from the hinge; none while untouched",
                               chart="contact")),
        *of_each_palm(Quantity("pressure{}", "number", "", "last pressure of pad {}, counts", chart="pressure")),
        *of_each_palm(Quantity("age{}_ms", "number", "ms", "age of pad {}'s last packet", "pad {}", "age", digits=0)),
        Quantity("arm_age_ms", "number", "ms", "age of the arm's last report", "arm", "age", digits=0),
        *of_each_palm(Quantity("touch{}", "bool", "", "whether pad {} is touched")),
        *of_each_palm(Quantity("batch{}", "bool", "", "whether pad {}'s last packet came with others in one read")),
    ),
)  # fmt: skip
FOLLOWING_RAD = following("rad")
MOTION = Topic(
    "palm/motion",
    100.0,
    "every tick",
    (
        *of_each_palm(Quantity("phi{}_cmd_rad", "number", "rad", "commanded; none unless tracking",
                               "φ{sub}", "angles", digits=2)),
        *of_each_palm(Quantity("phi{}_rad", "number", "rad", "actual, from the arm's last report", "φ{sub}", digits=2)),
        Quantity("plan", "text", "", "name of the plan, empty without one"),
        Quantity("segment", "number", "", "number of the plan's segment from 0; -1 when no plan is being run"),
        Quantity("progress", "number", "",
                 "of the plan, 0 to 1; of the round when it runs forever, of touching when it explores"),
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
        Quantity("faults", "texts", "", "codes of the faults that stand, latched ones included"),
        Quantity("severities", "texts", "", "note, degrade, hold or stop, one for each fault"),
        Quantity("hints", "texts", "", "what to do, one for each fault"),
        Quantity("texts", "texts", "", "what is the matter, one for each fault"),
        Quantity(
            "cause", "text", "", "what has brought the state about, in words; empty when nothing has since the start"
        ),
        Quantity(
            "wish", "text", "", "hold or stop, from when somebody asks for it until arm, start or reset; else empty"
        ),
        Quantity("control", "text", "", "the client that has control of the rig; empty for nobody"),
        Quantity(
            "unattended",
            "bool",
            "",
            "whether a plan moves the palms and no client with a declared lease answers for it",
        ),
        Quantity("since_s", "number", "s", "for how long it has been in that state"),
        Quantity("running", "bool", "", "whether a plan is under way: one that is held or over is not"),
        Quantity(
            "exploring", "bool", "", "whether an exploration is going on; what follows is about it, else the last"
        ),
        Quantity("explored_s", "number", "s", "how long it has taken, holds left out; none before the first"),
        Quantity("coverage", "number", "", "share touched of the normals that can be reached; none while unknown"),
        Quantity("coverage_goal", "number", "", "the share at which it is done"),
        Quantity("reachable", "number", "", "share of all normals that can be reached; none while unknown"),
        Quantity("reason", "text", "", "why it stands or why it is over, in words; empty while it goes on"),
    ),
)
LOOP = Topic(
    "palm/loop",
    1.0,
    "",
    (
        Quantity("ticks", "number", "", "ticks since the start"),
        Quantity("overruns", "number", "", "ticks skipped since the start because another one took too long",
                 chart="missed"),
        *(
            Quantity(f"{what}_{part}_ms", "number", "ms", f"{meaning}, {words} of the last second", part, what,
                     digits=2)
            for what, meaning in (("lateness", "how late a tick began"), ("work", "how long a tick took"))
            for part, words in (("p50", "median"), ("p99", "99th percentile"), ("max", "largest"))
        ),
        Quantity("lateness_ms", "numbers", "ms", "how late each tick of the last second began, in their order"),
        *(
            Quantity(f"{port}_*", "number", "", f"what has passed on the {port} port since the start, by cause")
            for port in dict.fromkeys((*ENDS, *(f"pad{number}" for number in PAD_NUMBERS)))
        ),
        Quantity("bus_*", "number", "", "what has passed on the bus since the start"),
        Quantity("lag_ms", "number", "ms", "by how much the arm follows its set-points, estimated"),
        Quantity("late_dropped", "number", "", "samples too late for the observer since the start", chart="missed"),
        Quantity("smoother_*", "number", "",
                 "since the start: improvements taken in, starts of its process, readings lost"),
        Quantity("explorer_*", "number", "",
                 "since the start: starts of its process, decisions that came too late"),
        Quantity("rss_mb", "number", "MB", "resident memory", digits=0),
        Quantity("blocks", "number", "", "live blocks of the interpreter's memory: more and more tell a leak"),
        Quantity("backend", "text", "", "what runs the models: c, vm or numpy"),
    ),
)  # fmt: skip


def who_runs(system: str = "") -> tuple[Quantity, ...]:
    """What the info of every system begins with; two palms do not name themselves."""
    return (
        Quantity("version", "text", "", "of palmd"),
        Quantity("schema", "number", "", "of these messages"),
        *((Quantity("system", "text", "", system),) if system else ()),
        Quantity("config_hash", "text", "", "sha256 of the effective configuration"),
        Quantity("observer", "text", "", "the observer that runs"),
        Quantity("rate_hz", "number", "Hz", "of the ticks"),
        Quantity("units", "text", "", "where the units are"),
    )


PLANS_BESIDE = Quantity(
    "plans", "texts", "", "the plans that lie beside the configured one, as the plan command takes them"
)
INFO = Topic(
    "palm/info",
    1.0,
    "",
    (
        *who_runs(),
        Quantity("hinge", "text", "", "what joins the palms: arc or fixed"),
        Quantity("gravity_m_s2", "number", "m/s²", "in the plane of the palms"),
        Quantity(
            "base_m", "numbers", "m", f"far end of palm {PALMS[0]}, where an arc hinge is fixed: x and y, world frame"
        ),
        *of_each_palm(Quantity("palm{}_length_m", "number", "m", "palm {}, from the hinge to its far end")),
        *of_each_palm(Quantity("pad{}_length_m", "number", "m", "pad {}, from the hinge on")),
        *of_each_palm(Quantity("phi{}_limits_rad", "numbers", "rad", "least and largest phi{}")),
        *of_each_palm(
            Quantity(
                "palm{}_curvature_per_m", "number", "1/m", "of the arc that palm {} is: > 0 concave, 0 flat, < 0 convex"
            )
        ),
        Quantity("palms", "numbers", "", "the palms' numbers, which stand in the names of their quantities"),
        Quantity("joints", "texts", "", "the joint that turns each palm against the one before, as in <joint>_rad"),
        Quantity("sides", "numbers", "", "where the object is, seen along each palm from the hinge: 1 left, -1 right"),
        PLANS_BESIDE,
        Quantity("rate_limit_rad_s", "number", "rad/s", "of each palm angle"),
        Quantity("acceleration_limit_rad_s2", "number", "rad/s²", "of each palm angle"),
        Quantity("force_limit_n", "numbers", "N", "what may press on each pad, palm by palm"),
    ),
)
TICK = Quantity("t_tick_s", "number", "s", "the tick's time, CLOCK_MONOTONIC, to the last bit")
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
            "of each event that the observer was fed, in this order: 1 or 2 a reading of that pad, -1 or -2 the end "
            "of its contact, 0 the palms",
        ),
        Quantity("t_sample_s", "numbers", "s", "when it was true, CLOCK_MONOTONIC"),
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
        Quantity("t_s", "number", "s", "what instant the answer is about, CLOCK_MONOTONIC", source="t"),
        Quantity("x", "numbers", "SI", "mean of the shape map's state", source="x"),
        Quantity("covariance", "numbers", "SI", "of that state, were `rig` right, row after row", source="P"),
        Quantity("frame", "number", "", "another when the outline has another gauge than in the answer before",
                 source="frame"),
        Quantity("established", "bool", "", "whether it has proved true for so long that no rival is kept",
                 source="established"),
        Quantity("touched", "numbers", "", "0 or 1 for each of 72 bins of outward normals, the first beginning at 0",
                 source="touched"),
        Quantity("rig", "numbers", "SI", "what the rig's constants are off by, in the order of `palm/rig`",
                 source="rig"),
        Quantity("rig_sd", "numbers", "SI", "one-sigma of each", source="rig_sd"),
        Quantity("spread", "numbers", "SI", "what one-sigma steps of what is open of `rig` move: state, then `rig`",
                 source="spread"),
        Quantity("contradicted", "numbers", "", "by how many sigmas each of `rig` is not what it was taken for, or 0",
                 source="contradicted"),
    ),
)  # fmt: skip
UNEXPLAINED = Topic(
    "palm/unexplained",
    0.0,
    "when the smoother beside the loop finds nothing that explains the readings",
    (TICK, Quantity("t_s", "number", "s", "of the last of those readings, CLOCK_MONOTONIC")),
)
RIG = Topic(
    "palm/rig",
    1.0,
    "and when the smoother beside the loop has answered",
    (
        *(Quantity(constant.name, "number", constant.unit, constant.meaning, role="derived") for constant in RIG_TABLE),
        Quantity("sd", "sds", "", "one-sigma of each of them; until readings have told it, that of the configuration"),
        Quantity("prior_sd", "numbers", "SI", "one-sigma of each by the configuration, in the order of these rows"),
        Quantity("off", "texts", "", "in words, what readings have told to be off beyond doubt, and what to do"),
    ),
)
LOG_ENTRIES = 100
LOG = Topic(
    "palm/log",
    1.0,
    "and with each new entry, 10 Hz at most",
    (
        Quantity("number", "numbers", "",
                 f"of each of the last {LOG_ENTRIES} entries, in their order, counted from 0 since the daemon's start"),
        Quantity("t_s", "numbers", "s", "when it was, CLOCK_MONOTONIC"),
        Quantity(
            "kind",
            "texts",
            "",
            "what it is about: palmd, state, fault, command, control, plan, exploration, object, rig, recorder",
        ),
        Quantity("name", "texts", "",
                 "the state come to, the code of the fault, the command; else begun, over, stopping, known, lost …"),
        Quantity("severity", "texts", "", "of a fault: note, degrade, hold or stop; else empty"),
        Quantity("who", "texts", "", "who gave the command that it comes from; else empty"),
        Quantity("lasted_s", "numbers", "s", "of what is over: how long it had lasted; else none"),
        Quantity("text", "texts", "", "in plain words, with the cause: which byte, which age, which limit"),
    ),
)  # fmt: skip
NOTE = Topic(
    "palm/note",
    0.0,
    "when somebody has given one",
    (
        Quantity("t_s", "number", "s", "when it was given, CLOCK_MONOTONIC"),
        Quantity("text", "text", "", "what somebody has to say about this time of the run"),
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
"""What a recorder keeps, whatever configuration it was started with."""

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
        Quantity("object", "number", "", "counts up when another object is put on the palms"),
        Quantity("arm_state", "text", "", "the controller's state letter"),
    ),
)  # fmt: skip
BODY = Topic(
    "rig/object",
    1.0,
    "",
    (
        Quantity("object", "number", "", "as in rig/truth"),
        Quantity("kind", "text", "", "what kind of object was drawn"),
        Quantity("shape", "text", "", "what the outline is made of"),
        Quantity("theta_rad", "numbers", "rad", "direction of the outward normal in a frame that turns by psi_rad"),
        Quantity("h_m", "numbers", "m", "support function about the centre of mass"),
        *(
            replace(ESTIMATE[name], chart="", role="plain", source="", glance=False)
            for name in ("rho_m", "mass_kg", "mu")
        ),
        Quantity("dither_m_s", "number", "m/s", "dither speed u_d of the friction law"),
        Quantity("damping_m2_s", "number", "m²/s", "damping of its turning, per unit mass"),
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
"""What `palmd replay` publishes besides, so that nobody takes an old run for what is going on."""

STALL = Topic(
    "rig/stall",
    0.0,
    "when it has stood still for more than 20 ms for want of a processor",
    (
        Quantity("t_s", "number", "s", "when it went on, CLOCK_MONOTONIC"),
        Quantity("lasted_s", "number", "s", "for how long the emulated rig said nothing, which no real one would do"),
        Quantity("count", "number", "", "of such standstills since its start"),
    ),
)


@dataclass(frozen=True, slots=True)
class SystemTopics:
    """What every system tells, each in topics of its own, and in `besides` what others have not."""

    estimate: Topic
    shape: Topic
    contact: Topic
    motion: Topic
    events: Topic
    info: Topic
    truth: Topic
    """What its emulated rig says of the motion, and in `body` of the object."""
    body: Topic
    besides: tuple[Topic, ...] = ()

    @property
    def published(self) -> tuple[Topic, ...]:
        """Those of the daemon."""
        return self.estimate, self.shape, self.contact, self.motion, self.events, *self.besides, self.info


TWO_PALMS_TOPICS = SystemTopics(
    ESTIMATE, SHAPE, CONTACT, MOTION, EVENTS, INFO, TRUTH, BODY, (OBJECT, IMPROVEMENT, UNEXPLAINED)
)

UNITS = "SI; each name ends in its unit: _m _m2 _rad _rad_s _kg _kg_m _n _s _ms _ns _hz _mb _m_per_n"
