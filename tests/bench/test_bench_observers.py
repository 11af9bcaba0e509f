"""Duration of each observer's tick by bank size, and of one step of one filter in C."""

import time

import numpy as np
import pytest
from benchtable import PARTS, machine, percentiles, show
from simulated import simulated

from palmd.model import compiled, compiler, extended, shape_map
from palmd.observer import EXTENDED_BANK, SHAPE_BANK
from palmd.observer.bank_observer import BankObserver
from palmd.observer.filters.extended import ExtendedFilters
from palmd.observer.filters.shape_map import ShapeFilters
from palmd.observer.quasistatic import QuasistaticObserver

pytestmark = [pytest.mark.bench, pytest.mark.timeout(300)]

KIND, SEED, SECONDS = "rig", 101, 6.0
PERIOD_S = 0.01
TICKS_PER_SHAPE = 10
SIZES = (8, 24, 40, 64)
USED = {"shape": SHAPE_BANK, "extended": EXTENDED_BANK}
FILTERS = {"shape": ShapeFilters, "extended": ExtendedFilters}
MODELS = {"shape": shape_map, "extended": extended}
CALLS, REPEATS = 200, 7


def tick_times(watcher, events):
    """Processor time (ms) of feed, estimate and, every tenth time, shape in each tick."""
    times, waiting = [], list(reversed(events))
    for k in range(1, round(SECONDS / PERIOD_S)):
        begun = time.thread_time()
        while waiting and waiting[-1].t_sample <= k * PERIOD_S:
            watcher.feed(waiting.pop())
        watcher.estimate(k * PERIOD_S)
        if k % TICKS_PER_SHAPE == 0:
            watcher.shape(k * PERIOD_S)
        times.append((time.thread_time() - begun) * 1e3)
    return times


def test_bench_tick_of_the_observers():
    run = simulated(KIND, SEED, SECONDS)
    rig, events = run.rig, run.events
    rows = []
    for name in FILTERS:
        for size in SIZES:
            watcher = BankObserver(FILTERS[name](rig, size), rig)
            used = ", used" if size == USED[name] else ""
            rows.append((f"{name}, bank of {size}{used}", *percentiles(tick_times(watcher, events))))
    rows.append(("quasistatic", *percentiles(tick_times(QuasistaticObserver(rig), events))))
    show(
        f"feed and estimate in a tick of 10 ms, {KIND} log, seed {SEED}, {SECONDS:g} s (ms of processor time)",
        PARTS,
        rows,
    )
    print(f"  {machine()}")
    assert all(row[1] < PERIOD_S * 1e3 for row in rows)


def step_time(library, name):
    """Time of one kernel call for one filter (µs): the best of several means."""
    shape = library.signatures[name]
    rng = np.random.default_rng(SEED)
    columns = [1 if i in shape.shared or not shape.columns else compiled.LANES for i in range(len(shape.inputs))]
    inputs = [rng.uniform(0.2, 0.9, count * size) for count, (_, size) in zip(columns, shape.inputs, strict=True)]
    outputs = [np.zeros(columns[0] * size) for _, size in shape.outputs]
    call = library.bind(name, inputs, outputs)
    best = np.inf
    for _ in range(REPEATS):
        begun = time.perf_counter()
        for _ in range(CALLS):
            call()
        best = min(best, (time.perf_counter() - begun) / CALLS)
    return best * 1e6 / (compiled.LANES if name.endswith("_block") else 1)


def test_bench_one_step_of_one_filter(monkeypatch):
    rows = []
    for name in FILTERS:
        model = MODELS[name]
        fast = model.library()
        with monkeypatch.context() as patch:
            patch.delenv("CC", raising=False)
            patch.setattr(compiled, "_opened", lambda _: None)
            patch.setattr(compiler.shutil, "which", lambda _: None)
            slow = model.library.__wrapped__()  # not the cached one
        assert slow.backend == "vm"
        for kernel in ("predict", "update_s1"):
            c, vm = (step_time(library, f"{kernel}_block") for library in (fast, slow))
            rows.append((f"{name} ({model.N} states) {kernel}", c, vm, vm / c))
    backend = "C" if fast.backend == "c" else "no compiler: virtual machine"
    show(f"one step of one filter, in blocks of {compiled.LANES} (µs)", (backend, "virtual machine", "ratio"), rows)
    print(f"  {machine()}")
    if fast.backend == "c":
        assert all(ratio > 1.5 for *_, ratio in rows)
