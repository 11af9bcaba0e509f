"""Runs composed message by message, so that every statement of a report about them is known beforehand."""

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
GAUGE = 1.3  # estimated ψ minus true ψ (rad)
SD_M = 1e-5  # 1σ of r1, r2 and h
OFF_M = 4e-6  # error of every h
VALID_FROM_S = 0.5
EVERY_FOURTH = 3.0  # error of r1 in standard deviations in every fourth tick, half as much in the others
THETA = np.arange(180) * (math.tau / 180)
DEGREES = np.arange(360) * (math.tau / 360)


def true_h(theta):
    return 0.02 + 1.5e-3 * np.cos(2 * theta + 0.4) + 4e-4 * np.sin(3 * theta)


def true_psi(t):
    return 0.4 * math.sin(2.0 * t)


def fields_of(topic, **said):
    """All fields of a topic; 0 or empty where not given."""
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
    estimated = {name: value for name, value in truth(t, number).items() if name not in ("contact1", "contact2")}
    estimated["r1_m"] += SD_M * (EVERY_FOURTH if tick % 4 == 0 else EVERY_FOURTH / 2)
    estimated["psi_rad"] += GAUGE
    estimated |= {"rho_m": 0.014, "mu": 0.2, "mass_kg": 0.13, "v1_m": 0.02, "v2_m": 0.02}
    sd = {name: SD_M if name in ("r1_m", "r2_m") else 0.01 for name in estimated if name != "object"}
    return fields_of(
        ESTIMATE, valid=valid, observer=observer, sd=sd, nis=1.0, observability=0.3, touched=min(0.9, 0.3 * t),
        e_f_m=math.nan, **estimated,
    )  # fmt: skip


def shape(t):
    touched = (min(0.9, 0.3 * t) * math.tau > THETA).astype(int).tolist()
    h = true_h(THETA + GAUGE) + OFF_M
    return fields_of(SHAPE, theta_rad=THETA.tolist(), h_m=h.tolist(), h_sd_m=[SD_M] * 180, touched=touched)


def state(t):
    """One fault from 0.6 s to 0.9 s, another from 1 s."""
    stands = {"arm-late": 0.6 <= t < 0.9, "pad1-garbled": t >= 1.0}
    codes = [code for code, there in stands.items() if there]
    what = "idle" if t < 0.2 else "tracking"
    return fields_of(
        STATE, state=what, faults=codes, severities=["degrade"] * len(codes), hints=[f"mend <{code}>" for code in codes]
    )


def messages(seconds, *, observer="shape", shapes=True, truths=True, valid=True, second_from=math.inf, lost=()):
    """(topic, fields, t, number) of a run; ticks in `lost` are missing; from `second_from` (s) object 2 is on the
    palms.
    """
    numbers = {}

    def one(topic, fields, t):
        number = numbers[topic] = numbers.get(topic, -1) + 1
        return topic, fields, t, number

    for tick in range(round(seconds / TICK_S)):
        t = tick * TICK_S
        number = 2 if t >= second_from else 1
        settled = valid and t >= VALID_FROM_S
        of_tick = [one(ESTIMATE.name, estimate(tick, number, observer, settled), t)]
        of_tick.append(one(CONTACT.name, fields_of(CONTACT, age1_ms=9.0, age2_ms=11.0, arm_age_ms=math.nan), t))
        moved = {"phi1_rad": 0.7, "phi2_rad": 1.5, "phi1_cmd_rad": math.nan, "phi2_cmd_rad": math.nan}
        segment = -1 if t < 0.3 else int(t)
        of_tick.append(one(MOTION.name, fields_of(MOTION, plan="rock", segment=segment, arm_state="T", **moved), t))
        if tick % 10 == 0:
            of_tick.append(one(STATE.name, state(t), t))
            if shapes:
                of_tick.append(one(SHAPE.name, shape(t), t))
        if tick % 100 == 0:
            of_tick.append(one(LOOP.name, fields_of(LOOP, ticks=tick, overruns=2, pad1_bad_header=3, backend="c"), t))
        if truths:
            of_tick.append(one("rig/truth", truth(t, number), t))
            if tick % 100 == 0:
                body = {"h_m": true_h(DEGREES).tolist(), "rho_m": 0.014, "mass_kg": 0.13, "mu": 0.2}
                of_tick.append(one("rig/object", body, t))
        if tick not in lost:
            yield from of_tick


def write_packed(path, messages):
    """Writes the messages in chunks with valid checksums, whatever the contents; returns the file."""
    begin = preface(recorded.config(path.parent), BEGIN.isoformat())
    return recorded.written(path, map(_raw, messages), begin, compressed=True)


def _raw(message):
    topic, fields, t, number = message
    t_ns = round((BEGIN.timestamp() + t) * 1e9)
    payload = msgpack.packb(stamp(dict(fields), BEGIN.timestamp() + t, 100.0 + t, number))
    return RawMessage(topic, t_ns, t_ns, number, payload)


def write(folder, messages, *, finish=True):
    """Writes the messages as a recording; returns the file."""
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
    """The series that a report reads from these messages."""
    run = read_run(write(folder, messages, **how))
    return series_of(run, run.survey())
