"""What reconstructing ten seconds from a blind start costs, and what the smoother's iteration does."""

import time

import numpy as np
import pytest
from benchtable import PARTS, machine, percentiles, show
from palms import palm_sample

from palmd.events import PadSample
from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.reconstruct import reconstruct
from palmd.observer.smoothing import Session
from palmd.rig.shapes import KINDS
from palmd.rig.simulate import simulate_log
from palmd.system.description import RigDescription

pytestmark = [pytest.mark.bench, pytest.mark.timeout(300)]

SEEDS, SECONDS = range(4), 10.0


def log_of(kind, seed):
    header, *lines = simulate_log(kind, seed, SECONDS)[0]
    hinge = header["rig"]["hinge"]
    events = []
    for line in lines:
        if "pad" in line:
            events.append(PadSample(line["t"], line["pad"], line["s_m"], line["force_n"]))
        else:
            events.append(palm_sample(line))
    return events, RigDescription(hinge=hinge["mode"], palm1_length=hinge.get("palm1_length_m", 0.12))


def test_bench_reconstruct():
    rows = []
    for kind in KINDS:
        logs = [log_of(kind, seed) for seed in SEEDS]
        reconstruct(*logs[0])  # compiles, fills caches
        answers = [reconstruct(*log) for log in logs]
        assert all(answer.converged for answer in answers)
        rows.append((kind, *percentiles([answer.seconds for answer in answers])))
    show(f"reconstructing {SECONDS:g} s from a blind start (s), seeds {SEEDS.start}..{SEEDS.stop - 1}", PARTS, rows)
    print(f"  {machine()}")


def test_bench_incremental_smoother():
    events, rig = log_of("rig", 0)
    smoother = IncrementalSmoother(rig)
    times, given = [], 0
    for end in np.arange(1.5, SECONDS, 0.5):
        upto = sum(event.t_sample < end for event in events)
        begun = time.perf_counter()
        smoother.add(Session(1, 0.0), events[given:upto])
        smoother.answer()
        times.append(time.perf_counter() - begun)
        given = upto
    show("one answer beside the loop, rig log of 1.5 to 10 s (s)", PARTS, [("answer", *percentiles(times))])
    print(f"  {machine()}")
