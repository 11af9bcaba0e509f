"""Duration of a blind reconstruction of ten seconds, and of the smoother's iteration."""

import time

import numpy as np
import pytest
from benchtable import PARTS, machine, percentiles, show
from simulated import simulated

from palmd.observer.incremental import IncrementalSmoother
from palmd.observer.reconstruct import reconstruct
from palmd.observer.smoothing import Session
from palmd.rig.shapes import KINDS

pytestmark = [pytest.mark.bench, pytest.mark.timeout(300)]

SEEDS, SECONDS = range(4), 10.0


def test_bench_reconstruct():
    rows = []
    for kind in KINDS:
        logs = [simulated(kind, seed, SECONDS) for seed in SEEDS]
        reconstruct(logs[0].events, logs[0].rig)  # compiles, fills caches
        answers = [reconstruct(log.events, log.rig) for log in logs]
        assert all(answer.converged for answer in answers)
        rows.append((kind, *percentiles([answer.seconds for answer in answers])))
    show(f"reconstructing {SECONDS:g} s from a blind start (s), seeds {SEEDS.start}..{SEEDS.stop - 1}", PARTS, rows)
    print(f"  {machine()}")


def test_bench_incremental_smoother():
    log = simulated("rig", 0, SECONDS)
    events, smoother = log.events, IncrementalSmoother(log.rig)
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
