"""Runs made up message by message, so that everything a report says of them is known beforehand."""

import math
from datetime import UTC, datetime

import msgpack
import numpy as np
import recorded

from palmd.messages import stamp
from palmd.quantities import CONTACT, ESTIMATE, LOOP, MOTION, SHAPE, STATE
from palmd.record.mcapfile import RawMessage
from palmd.record.metadata import preface
from palmd.record.run import read_run
from palmd.record.runfile import RunFile
from palmd.report.series import series_of

BEGIN = datetime(2026, 11, 21, 22, 30, 5, tzinfo=UTC)
TICK_S = 0.01
GAUGE = 1.3  # ψ as estimated less ψ as it is (rad)
SD_M = 1e-5  # of r1, r2 and h
OFF_M = 4e-6  # by which every h is too large
VALID_FROM_S = 0.5
EVERY_FOURTH = 3.0  # sds that r1 is off by in every fourth tick, half as many in the others
THETA = np.arange(180) * (math.tau / 180)
DEGREES = np.arange(360) * (math.tau / 360)


def true_h(theta):
    return 0.02 + 1.5e-3 * np.cos(2 * theta + 0.4) + 4e-4 * np.sin(3 * theta)


def true_psi(t):
    return 0.4 * math.sin(2.0 * t)


def fields_of(topic, **said):
    """All fields of a topic, 0 or empty where nothing is said."""
    empty = {"number": 0.0, "bool": False, "text": "", "texts": [], "numbers": [], "sds": {}}
    known = {field.name: empty[field.kind] for field in topic.quantities if not field.name.endswith("*")}
    return known | said


def truth(t, number):
    names = (
        "r1_m",
        "r2_m",
        "s1_m",
        "s2_m",
        "phi1_rad",
        "phi2_rad",
        "omega1_rad_s",
        "omega2_rad_s",
        "com_x_m",
        "com_y_m",
    )
    values = (0.02, 0.021, 0.03, 0.031, 0.7, 1.5, 0.0, 0.0, 0.0, 0.03)
    return dict(zip(names, values, strict=True)) | {
        "psi_rad": true_psi(t), "omega0_rad_s": 0.8 * math.cos(2.0 * t), "f1_n": 1.0, "f2_n": 1.1, "contact1": True,
        "contact2": True, "object": number,
    }  # fmt: skip


def estimate(tick, number, observer, valid):
    t = tick * TICK_S
    told = {name: value for name, value in truth(t, number).items() if name not in ("contact1", "contact2")}
    told["r1_m"] += SD_M * (EVERY_FOURTH if tick % 4 == 0 else EVERY_FOURTH / 2)
    told["psi_rad"] += GAUGE
    told |= {"rho_m": 0.014, "mu": 0.2, "mass_kg": 0.13, "v1_m": 0.02, "v2_m": 0.02}
    sd = {name: SD_M if name in ("r1_m", "r2_m") else 0.01 for name in told if name != "object"}
    return fields_of(
        ESTIMATE, valid=valid, observer=observer, sd=sd, nis=1.0, observability=0.3, touched=min(0.9, 0.3 * t),
        e_f_m=math.nan, **told,
    )  # fmt: skip


def shape(t):
    touched = (min(0.9, 0.3 * t) * math.tau > THETA).astype(int).tolist()
    h = true_h(THETA + GAUGE) + OFF_M
    return fields_of(SHAPE, theta_rad=THETA.tolist(), h_m=h.tolist(), h_sd_m=[SD_M] * 180, touched=touched)


def state(t):
    """One fault from 0.6 s to 0.9 s, another from 1 s on."""
    stands = {"arm-late": 0.6 <= t < 0.9, "pad1-garbled": t >= 1.0}
    codes = [code for code, there in stands.items() if there]
    what = "idle" if t < 0.2 else "tracking"
    return fields_of(
        STATE, state=what, faults=codes, severities=["degrade"] * len(codes), hints=[f"mend <{code}>" for code in codes]
    )


def told(seconds, *, observer="shape", shapes=True, truths=True, valid=True, second_from=math.inf, lost=()):
    """(topic, fields, t, number) of a run; ticks in `lost` are missing, from `second_from` (s) on lies object 2."""
    numbers = {}

    def one(topic, fields, t):
        number = numbers[topic] = numbers.get(topic, -1) + 1
        return topic, fields, t, number

    for tick in range(round(seconds / TICK_S)):
        t = tick * TICK_S
        number = 2 if t >= second_from else 1
        settled = valid and t >= VALID_FROM_S
        messages = [one(ESTIMATE.name, estimate(tick, number, observer, settled), t)]
        messages.append(one(CONTACT.name, fields_of(CONTACT, age1_ms=9.0, age2_ms=11.0, arm_age_ms=math.nan), t))
        moved = {"phi1_rad": 0.7, "phi2_rad": 1.5, "phi1_cmd_rad": math.nan, "phi2_cmd_rad": math.nan}
        segment = -1 if t < 0.3 else int(t)
        messages.append(one(MOTION.name, fields_of(MOTION, plan="rock", segment=segment, arm_state="T", **moved), t))
        if tick % 10 == 0:
            messages.append(one(STATE.name, state(t), t))
            if shapes:
                messages.append(one(SHAPE.name, shape(t), t))
        if tick % 100 == 0:
            messages.append(one(LOOP.name, fields_of(LOOP, ticks=tick, overruns=2, pad1_bad_header=3, backend="c"), t))
        if truths:
            messages.append(one("rig/truth", truth(t, number), t))
            if tick % 100 == 0:
                body = {"h_m": true_h(DEGREES).tolist(), "rho_m": 0.014, "mass_kg": 0.13, "mu": 0.2}
                messages.append(one("rig/object", body, t))
        if tick not in lost:
            yield from messages


def write_packed(path, messages):
    """The messages in chunks, whose checksums vouch for them whatever they say; the file."""
    begin = preface(recorded.config(path.parent), BEGIN.isoformat())
    return recorded.written(path, map(_raw, messages), begin, compressed=True)


def _raw(message):
    topic, fields, t, number = message
    t_ns = round((BEGIN.timestamp() + t) * 1e9)
    payload = msgpack.packb(stamp(dict(fields), BEGIN.timestamp() + t, 100.0 + t, number))
    return RawMessage(topic, t_ns, t_ns, number, payload)


def write(folder, messages, *, finish=True):
    """The messages as a recording; the file."""
    file = RunFile(folder, preface(recorded.config(folder), BEGIN.isoformat()), BEGIN)
    for message in messages:
        file.write(_raw(message))
    file.flush()
    if finish:
        file.finish()
    else:
        file.abandon()
    return file.path


def series(folder, messages, **how):
    """A run of these messages as a report reads it."""
    run = read_run(write(folder, messages, **how))
    return series_of(run, run.survey())
