"""Topics published about a body between three palms in space; see `palmd.quantities`."""

from __future__ import annotations

from dataclasses import replace

from palmd.quantities import AVAILABLE_PLANS, MOTION, TICK, Quantity, SystemTopics, Topic, runtime_quantities
from palmd.system.three_palms import JOINTS, PALMS, SYSTEM

WORLD_AXES = ("x", "y", "z")
INERTIA_ENTRIES = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Entries of a body's inertia, in its own frame."""
BODY_SURFACE = (
    Quantity("halvings", "number", "",
             "subdivisions of the icosahedron whose vertices are the directions: its twelve, then at each subdivision "
             "the middles of all edges, ordered by the numbers of their ends; 4 gives 2562"),
    Quantity("h_m", "numbers", "m", "support function about the centre of mass, in the body's frame"),
)  # fmt: skip
PALM3 = Topic(
    "palm3/estimate",
    100.0,
    "every tick, of three palms in space",
    (
        Quantity("invalid_reasons", "texts", "", "codes of the reasons why it is not valid, empty when valid"),
        Quantity("valid", "bool", "", "whether the estimate passed all tests and still agrees with the readings"),
        Quantity("observer", "text", "", "observer that made the estimate"),
        Quantity("object", "number", "", "counts up when a new object is begun"),
        Quantity("quat_xyzw", "numbers", "",
                 "rotation from the body's frame to the world's, x, y, z, w; 1 at the start of the smoother's record"),
        Quantity("attitude_sd_rad", "numbers", "rad", "1σ of the rotation about the world's x, y and z"),
        *(Quantity(f"omega_{axis}_rad_s", "number", "rad/s", f"angular velocity about the world's {axis}",
                   f"ω{axis}", "rate", "named", glance=True) for axis in WORLD_AXES),
        *(Quantity(f"com_{axis}_m", "number", "m", f"centre of mass from the palms' apex, world {axis}", axis,
                   "place", "named", glance=axis == "z") for axis in WORLD_AXES),
        *(Quantity(f"{joint}_rad", "number", "rad", f"joint angle {joint}", symbol, "angles", "derived")
          for joint, symbol in zip(JOINTS, ("β", "γ₂", "γ₃"), strict=True)),
        *(Quantity(f"{joint}_rate_rad_s", "number", "rad/s", f"planned rate of {joint}")
          for joint in JOINTS),
        *(Quantity(f"{side}{number}_m", "number", "m", f"contact on pad {number}, {words}", f"{side}{number}",
                   role="named")
          for number in PALMS
          for side, words in (("a", "along its first axis"), ("b", "along its second axis, from the apex"))),
        *(Quantity(f"h{number}_m", "number", "m", f"distance of palm {number} from the centre of mass", f"h{number}",
                   "distance", "derived", palm=number) for number in PALMS),
        *(Quantity(f"f{number}_n", "number", "N", f"normal force of contact {number}", f"f{number}", "force", "derived",
                   glance=True, palm=number) for number in PALMS),
        *(Quantity(f"inertia_{entry}_m2", "number", "m²", f"inertia per unit mass, body frame, {entry}",
                   role="derived") for entry in INERTIA_ENTRIES),
        Quantity("mu", "number", "", "friction", "μ", role="derived", glance=True),
        Quantity("mass_kg", "number", "kg", "mass of the object", "m", role="derived", glance=True),
        Quantity("sd", "sds", "", "1σ of each field that it names, in that field's unit"),
        Quantity("nis", "number", "", "normalised innovation squared, running mean", "NIS", "nis", digits=2),
        Quantity("touched", "number", "", "fraction of directions within 4 degrees of a contact", "touched"),
        Quantity("hypotheses", "number", "", "number of motions that explain the readings so far; 0 before the first"),
        Quantity("reason", "text", "", "why it is not valid, in words; empty while it is"),
    ),
)  # fmt: skip
PALM3_SHAPE = Topic(
    "palm3/shape",
    2.0,
    "at most, of three palms in space, once a motion is known",
    (
        *BODY_SURFACE,
        Quantity("h_sd_m", "numbers", "m", "1σ of h"),
        Quantity("touched", "numbers", "", "1 within 4 degrees of a contact, else 0; where 0, h is an extrapolation"),
        Quantity("object", "number", "", "as in palm3/estimate"),
        Quantity("valid", "bool", "", "whether the latest palm3/estimate is valid"),
    ),
)
PALM3_CONTACT = Topic(
    "palm3/contact",
    100.0,
    "every tick, of three palms in space",
    (
        *(Quantity(f"{side}{number}_m", "number", "m", f"last reading of pad {number}; none while untouched")
          for side in ("b", "a") for number in PALMS),
        *(Quantity(f"pressure{number}", "number", "", f"last pressure of pad {number}, counts")
          for number in PALMS),
        *(Quantity(f"age{number}_ms", "number", "ms", f"age of pad {number}'s last packet", f"pad {number}", "age",
                   palm=number, digits=0)
          for number in PALMS),
        Quantity("arm_age_ms", "number", "ms", "age of the arm's last report", "arm", "age", digits=0),
        *(Quantity(f"touch{number}", "bool", "", f"whether pad {number} is touched") for number in PALMS),
        *(Quantity(f"batch{number}", "bool", "", f"whether pad {number}'s last packet came with others in one read")
          for number in PALMS),
    ),
)  # fmt: skip
PALM3_MOTION = Topic(
    "palm3/motion",
    100.0,
    "every tick, of three palms in space",
    (
        *(Quantity(f"{joint}_cmd_rad", "number", "rad", f"commanded {joint}; none unless tracking")
          for joint in JOINTS),
        *(Quantity(f"{joint}_rad", "number", "rad", f"measured {joint}, from the arm's last report")
          for joint in JOINTS),
        *MOTION.quantities[-6:],
    ),
)  # fmt: skip
PALM3_EVENTS = Topic(
    "palm3/events",
    100.0,
    "every tick, of three palms in space",
    (
        TICK,
        Quantity("source", "numbers", "",
                 "of each event that the observer was fed: a pad's number for a reading, less than 0 for the end of "
                 "its contact, 0 the joints"),
        Quantity("t_sample_s", "numbers", "s", "time of the sample, CLOCK_MONOTONIC"),
        Quantity("b_m", "numbers", "m", "of a reading: contact along the pad's second axis, from the apex"),
        Quantity("a_m", "numbers", "m", "of a reading: contact along its first axis"),
        Quantity("force_n", "numbers", "N", "of a reading: normal force"),
        *(Quantity(f"{joint}_rad", "numbers", "rad", f"of the joints: measured {joint}")
          for joint in JOINTS),
        *(Quantity(f"{joint}_rate_rad_s", "numbers", "rad/s", f"of the joints: planned rate of {joint}")
          for joint in JOINTS),
        *(Quantity(f"{joint}_acc_rad_s2", "numbers", "rad/s²", f"of the joints: planned acceleration of {joint}")
          for joint in JOINTS),
    ),
)  # fmt: skip
PALM3_ANSWER = Topic(
    "palm3/answer",
    0.0,
    "when the smoother beside the loop has answered, of three palms in space",
    (
        TICK,
        Quantity("t_s", "number", "s", "time of the estimate, CLOCK_MONOTONIC", source="t"),
        Quantity("record_start_s", "number", "s", "start of the record it is estimated from", source="record_start"),
        Quantity("accepted", "bool", "", "whether the estimate is accepted", source="accepted"),
        Quantity("reason", "text", "", "why it is rejected, in words; empty if it is accepted", source="reason"),
        Quantity("reason_code", "text", "", "the [code](#reasons) of that reason", source="reason_code"),
        Quantity("hypotheses", "number", "", "number of motions that explain the readings so far", source="hypotheses"),
        Quantity("R", "numbers", "", "rotation from body to world at that time, matrix row by row", source="R"),
        Quantity("omega_rad_s", "numbers", "rad/s", "its angular velocity, world", source="omega"),
        Quantity("p", "numbers", "SI", "the body: harmonics of its surface, inertia, damping, friction", source="p"),
        Quantity(
            "covariance",
            "numbers",
            "SI",
            "of turns in the world, angular velocity and p, row by row",
            source="covariance",
        ),
        Quantity("h_m", "numbers", "m", "support function, in each direction of palm3/shape", source="h"),
        Quantity("h_sd_m", "numbers", "m", "its 1σ", source="h_sd"),
        Quantity("touched", "numbers", "", "1 where it was touched, else 0, for each direction", source="touched"),
        Quantity(
            "inertia_sd_m2", "numbers", "m²", "1σ of the inertia per unit mass, row by row", source="inertia_sd"
        ),
        Quantity("mass_kg", "number", "kg", "mass of the object; none without force readings", source="mass"),
        Quantity("mass_sd_kg", "number", "kg", "its 1σ", source="mass_sd"),
        Quantity("unexplained_sd_m", "number", "m", "1σ of the readings' errors beyond their noise",
                 source="unexplained_sd"),
    ),
).with_former_names()  # fmt: skip
PALM3_INFO = Topic(
    "palm3/info",
    1.0,
    "of three palms in space",
    (
        *runtime_quantities(SYSTEM),
        Quantity("mechanism", "text", "",
                 "edge-axis: with b = (0, cos beta, sin beta), palm normals n1 = (0, −sin beta, cos beta), "
                 "n2 = cos gamma2 X + sin gamma2 b, n3 = −cos gamma3 X + sin gamma3 b, all palms through the apex 0; "
                 "pad axes (a, b): (X, b), (∂n2/∂gamma2, n1), (∂n3/∂gamma3, n1)"),
        Quantity("joints", "texts", "", "names of the joints, as in <joint>_rad"),
        Quantity("palms", "numbers", "", "numbers of the palms, as in the names of their quantities"),
        Quantity("gravity_m_s2", "number", "m/s²", "along the world's −z"),
        Quantity("pad_side_m", "number", "m", "of each square pad"),
        *(Quantity(f"pad{number}_centre_m", "numbers", "m", f"a and b of the middle of pad {number}")
          for number in PALMS),
        *(Quantity(f"{joint}_limits_rad", "numbers", "rad", f"smallest and largest {joint}")
          for joint in JOINTS),
        Quantity("rate_limit_rad_s", "number", "rad/s", "of each joint"),
        Quantity("acceleration_limit_rad_s2", "number", "rad/s²", "of each joint"),
        Quantity("force_limit_n", "numbers", "N", "force limit of each pad, palm by palm"),
        AVAILABLE_PLANS,
    ),
)  # fmt: skip
PALM3_TRUTH = Topic(
    "rig/palm3",
    100.0,
    "of three palms in space",
    (
        Quantity("quat_xyzw", "numbers", "", "rotation from the body's own frame to the world's, x, y, z, w"),
        *(
            replace(quantity, role="plain", glance=False)
            for quantity in PALM3.quantities
            if quantity.name.startswith(("omega_", "com_", "a", "b", "gamma", "f")) and quantity.kind == "number"
        ),
        *(Quantity(f"touch{number}", "bool", "", f"whether it touches pad {number}") for number in PALMS),
        Quantity("object", "number", "", "counts up when another object is put on the palms"),
        Quantity("arm_state", "text", "", "the controller's state letter"),
    ),
)
PALM3_BODY = Topic(
    "rig/palm3_object",
    1.0,
    "of three palms in space",
    (
        Quantity("object", "number", "", "as in rig/palm3"),
        Quantity("shape", "text", "", "description of the body's shape"),
        *BODY_SURFACE,
        Quantity("inertia_m2", "numbers", "m²", "per unit mass, in its own frame, row by row"),
        Quantity("mass_kg", "number", "kg", "mass of the object"),
        Quantity("mu", "number", "", "friction"),
        Quantity("dither_m_s", "number", "m/s", "dither speed of the friction law"),
        Quantity("damping_m2_s", "number", "m²/s", "damping of its spin, per unit mass"),
    ),
)
PALM3_TOPICS = SystemTopics(
    PALM3, PALM3_SHAPE, PALM3_CONTACT, PALM3_MOTION, PALM3_EVENTS, PALM3_INFO, PALM3_TRUTH, PALM3_BODY, (PALM3_ANSWER,)
)
