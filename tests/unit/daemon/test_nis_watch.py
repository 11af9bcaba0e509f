"""The alarm for an observer whose model is wrong: on given numbers, and in closed loop."""

import math

import pytest

from palmd.config.two_palms import ImperfectionsConfig, PlanSpec
from palmd.daemon.diagnostics import NIS_MEMORY_S, NisDiagnostics
from palmd.rig.world import default_config
from tools.closed_loop import TwoPalmsLoop

CODE = "estimate-inconsistent"
ROCK = PlanSpec.model_validate(
    {
        "name": "rock",
        "segments": [{"sine": {"phi1_deg": 25, "phi2_deg": 10}, "frequency_hz": [0.41, 0.57], "duration_s": 20}],
    }
)


def after(watch: NisDiagnostics, nis: float, seconds: float, t0: float = 0.0, *, moving: bool = True) -> list[str]:
    codes: list[str] = []
    for k in range(round(seconds * 100)):
        codes = list(watch.conditions(nis, moving, t0 + k * 0.01))
    return codes


@pytest.mark.parametrize(("nis", "codes"), [(1.0, []), (0.7, []), (1.3, []), (2.0, [CODE]), (0.1, [CODE])])
def test_only_a_lasting_mean_outside_the_band_counts(nis, codes):
    assert after(NisDiagnostics(), nis, 4 * NIS_MEMORY_S) == codes


def test_a_short_excursion_is_ignored():
    watch = NisDiagnostics()
    assert after(watch, 3.0, 0.4) == []
    assert after(watch, 1.0, 3.0, 0.4) == []


def test_re_initialisation_does_not_hide_a_wrong_model():
    """Each restart begins with a mean of 1 and little weight on the readings, and some ticks have no NIS."""
    watch, codes = NisDiagnostics(), []
    for k in range(1000):
        young = k % 100
        nis = math.nan if young < 5 else 0.8 if young < 40 else 4.0
        codes = list(watch.conditions(nis, True, k * 0.01))
    assert codes == [CODE]


def test_at_rest_the_test_is_suspended():
    watch = NisDiagnostics()
    assert after(watch, 0.01, 20.0, moving=False) == []
    assert after(watch, 3.0, 10.0, 20.0) == [CODE]
    assert after(watch, 3.0, 0.01, 30.0, moving=False) == []


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("seed", "off", "alarm"),
    [
        (1, {}, False),
        (3, {}, False),
        (1, {"palm1": {"zero_mm": 2}, "palm2": {"zero_mm": -2}}, True),
        (4, {"palm1": {"zero_mm": 2}, "palm2": {"zero_mm": -2}}, True),
        (3, {"palm1": {"sagitta_mm": 1}, "palm2": {"sagitta_mm": -1}}, True),
    ],
)
def test_the_alarm_is_raised_for_misconfigured_pads_only(seed, off, alarm):
    config = default_config()
    rig = config.rig.model_copy(update={"imperfections": ImperfectionsConfig.model_validate(off)})
    run = TwoPalmsLoop(config.model_copy(update={"rig": rig}), ROCK, seed)
    run.start()
    raised = any(CODE in [fault.code for fault in run.core.faults.active] for _ in run.run(15.0))
    assert raised == alarm
