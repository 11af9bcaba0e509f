"""Topics published about a pivoting grasp; see `palmd.quantities`."""

from __future__ import annotations

from dataclasses import replace

from palmd.quantities import AVAILABLE_PLANS, MOTION, TICK, Quantity, SystemTopics, Topic, following, runtime_quantities
from palmd.system.pivot import AXES, SYSTEM

PIVOT = Topic(
    "palm/pivot",
    100.0,
    "every tick, of a pivoting grasp",
    (
        Quantity("invalid_reasons", "texts", "", "codes of the reasons why it is not valid, empty when valid"),
        Quantity("valid", "bool", "", "whether the outline is accepted, touched here, and agrees with the readings",
                 source="valid"),
        Quantity("observer", "text", "", "observer that made the estimate", source="observer"),
        Quantity("object", "number", "", "counts up when a new object is begun", source="object_count"),
        Quantity("x_m", "number", "m", "the pivot along the pad", "X", role="derived", source="x"),
        Quantity("z_m", "number", "m", "the pivot over the pad, which is h_P while the body touches", "z",
                 role="derived", source="z", glance=True),
        Quantity("s1_m", "number", "m", "contact on the pad", "s₁", role="derived", source="s", glance=True),
        Quantity("e_m", "number", "m", "contact ahead of the pivot, which is the slope of h_P", "e", role="derived",
                 source="e", glance=True),
        Quantity("psi_rad", "number", "rad", "turn of the object since the first reading that was used", "ψ",
                 role="named", source="psi", glance=True),
        Quantity("omega0_rad_s", "number", "rad/s", "angular rate of the object", "ω₀", role="named", source="omega0",
                 glance=True),
        Quantity("f1_n", "number", "N", "normal force of the contact", "f₁", role="derived", source="f", glance=True),
        Quantity("mu", "number", "", "friction", "μ", role="derived", source="mu", glance=True),
        Quantity("moment_kg_m", "number", "kg m", "mass times distance of the centre of mass from the pivot", "mb",
                 role="derived", source="moment"),
        Quantity("sd", "sds", "", "1σ of each field that it names, in that field's unit"),
        Quantity("side", "number", "", "side of the dead centre: 1 for e > 0, -1 for e < 0, 0 while untouched",
                 source="side"),
        Quantity("nis", "number", "", "normalised innovation squared, running mean", "NIS", source="nis", digits=2),
        Quantity("touched", "number", "", "fraction of normals that have been in contact", "touched",
                 source="touched"),
        Quantity("reason", "text", "", "why it is not valid, in words; empty while it is", source="reason"),
    ),
)  # fmt: skip
PIVOT_SHAPE = Topic(
    "palm/pivot_shape",
    10.0,
    "at most, of a pivoting grasp with an accepted outline",
    (
        Quantity("theta_rad", "numbers", "rad", "direction of the outward normal in the object's frame"),
        Quantity("hP_m", "numbers", "m", "support function about the pivot"),
        Quantity("hP_sd_m", "numbers", "m", "1σ of hP"),
        Quantity("touched", "numbers", "", "1 where the pad has been in contact, else 0"),
    ),
)
PIVOT_CONTACT = Topic(
    "palm/pivot_contact",
    100.0,
    "every tick, of a pivoting grasp",
    (
        Quantity("s1_m", "number", "m", "last reading of the pad; none while untouched"),
        Quantity("pressure1", "number", "", "its last pressure, counts"),
        Quantity("age1_ms", "number", "ms", "age of its last packet", digits=0),
        Quantity("arm_age_ms", "number", "ms", "age of the arm's last report", "arm", digits=0),
        Quantity("touch1", "bool", "", "whether it is touched"),
        Quantity("batch1", "bool", "", "whether its last packet came with others in one read"),
    ),
)
PIVOT_MOTION = Topic(
    "palm/pivot_motion",
    100.0,
    "every tick, of a pivoting grasp",
    (
        *(Quantity(f"{axis}_cmd_m", "number", "m", "commanded pivot; none unless tracking") for axis in AXES),
        *(Quantity(f"{axis}_m", "number", "m", "measured pivot, from the arm's last report") for axis in AXES),
        *MOTION.quantities[-6:-2],
        *following("m"),
    ),
)
PIVOT_EVENTS = Topic(
    "palm/pivot_events",
    100.0,
    "every tick, of a pivoting grasp",
    (
        TICK,
        Quantity("source", "numbers", "",
                 "of each event that the observer was fed: 1 a reading, -1 the end of the contact, 0 the gripper"),
        Quantity("t_sample_s", "numbers", "s", "time of the sample, CLOCK_MONOTONIC"),
        Quantity("s_m", "numbers", "m", "of a reading: contact"),
        Quantity("force_n", "numbers", "N", "of a reading: normal force"),
        *(Quantity(f"{axis}_m", "numbers", "m", "of the gripper: measured position") for axis in AXES),
        *(Quantity(f"v{axis}_m_s", "numbers", "m/s", "of the gripper: planned velocity") for axis in AXES),
        *(Quantity(f"a{axis}_m_s2", "numbers", "m/s²", "of the gripper: planned acceleration") for axis in AXES),
    ),
)  # fmt: skip
PIVOT_ANSWER = Topic(
    "palm/pivot_answer",
    0.0,
    "when the smoother beside the loop has answered, of a pivoting grasp",
    (
        TICK,
        Quantity("t_s", "number", "s", "time of the estimate, CLOCK_MONOTONIC", source="t"),
        Quantity("accepted", "bool", "", "whether the estimate is accepted", source="accepted"),
        Quantity("reason", "text", "", "why it is rejected, in words; empty if it is accepted", source="reason"),
        Quantity("reason_code", "text", "", "the [code](#reasons) of that reason", source="reason_code"),
        Quantity("psi_rad", "number", "rad", "orientation of the object at that time", source="psi"),
        Quantity(
            "p",
            "numbers",
            "SI",
            "constants: of the body about its pivot, of the rig, harmonics of the outline",
            source="p",
        ),
        Quantity("covariance", "numbers", "SI", "of p, row by row", source="covariance"),
        Quantity("hP_sd_m", "numbers", "m", "1σ of the outline, for each degree of its normals", source="h_sd"),
        Quantity("touched", "numbers", "", "1 where it was touched, else 0, for each degree", source="touched"),
    ),
).with_former_names()  # fmt: skip
PIVOT_INFO = Topic(
    "palm/pivot_info",
    1.0,
    "of a pivoting grasp",
    (
        *runtime_quantities(SYSTEM),
        Quantity("gravity_m_s2", "number", "m/s²", "towards the pad"),
        Quantity("pad1_length_m", "number", "m", "the pad, from its zero on"),
        *(Quantity(f"{axis}_limits_m", "numbers", "m", f"smallest and largest {axis} of the pivot") for axis in AXES),
        Quantity("force_limit_n", "number", "N", "limit of the body's force on the pad"),
        AVAILABLE_PLANS,
    ),
)
PIVOT_TRUTH = Topic(
    "rig/pivot",
    100.0,
    "of a pivoting grasp",
    (
        *(
            replace(PIVOT[name], role="plain", source="", glance=False)
            for name in ("x_m", "z_m", "s1_m", "e_m", "psi_rad", "omega0_rad_s", "f1_n")
        ),
        Quantity("touch1", "bool", "", "whether the body touches the pad"),
        Quantity("object", "number", "", "counts up when another object is held"),
        Quantity("arm_state", "text", "", "the controller's state letter"),
    ),
)
PIVOT_BODY = Topic(
    "rig/pivot_object",
    1.0,
    "of a pivoting grasp",
    (
        Quantity("object", "number", "", "as in rig/pivot"),
        Quantity("shape", "text", "", "description of the outline"),
        Quantity("theta_rad", "numbers", "rad", "direction of the outward normal in a frame that turns by psi_rad"),
        Quantity("hP_m", "numbers", "m", "support function about the pivot"),
        Quantity("com_m", "numbers", "m", "centre of mass from the pivot, in that frame"),
        Quantity("mass_kg", "number", "kg", "mass of the object"),
        Quantity("mu", "number", "", "friction"),
    ),
)
PIVOT_TOPICS = SystemTopics(
    PIVOT, PIVOT_SHAPE, PIVOT_CONTACT, PIVOT_MOTION, PIVOT_EVENTS, PIVOT_INFO, PIVOT_TRUTH, PIVOT_BODY, (PIVOT_ANSWER,)
)
