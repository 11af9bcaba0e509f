"""What is off while an object is explored: how far it leads an outline astray, and what counts as named in time."""

import math
from dataclasses import replace

import numpy as np
import pytest
from improvements import improvement

from palmd.model.shape_map import Z
from palmd.model.smoothing import ORDER, RIG_CONSTANTS, R
from palmd.observer.coverage import NORMAL_BINS
from palmd.rig.imperfections import configured
from palmd.system.rig_constants import RIG_NAMES
from tools.studies import off_explored
from tools.studies.off import OFF, VERDICTS
from tools.studies.off_explored import CAN_BE_OFF, ExploredRow, ExploredTask, led_astray, report


@pytest.mark.parametrize("off", [off for off in OFF if off.constants], ids=lambda off: off.name)
def test_the_rig_is_off_by_what_the_table_says_and_is_said_to_be_exact(off):
    config = off_explored._configured(off.constants)
    assert configured(config, 0).constants() == pytest.approx(dict.fromkeys(RIG_NAMES, 0.0) | dict(off.constants))
    assert config.rig.angle_sd_deg == config.pads.palm1.standoff_sd_mm == 0.0


def test_an_outline_is_led_astray_by_what_goes_with_the_constant():
    """Of a circle whose radius grows by three times its pad's height, told to 0.1 mm by itself."""
    n = Z.SHAPE + 2 * ORDER + 1
    outline, of_state = np.zeros(n), np.zeros((n, RIG_CONSTANTS))
    outline[Z.SHAPE], of_state[Z.SHAPE, R.STANDOFF] = 0.02, 3.0
    covariance = np.diag(np.where(np.arange(n) == Z.SHAPE, 1e-8, 1e-20))
    spread, everywhere = np.vstack([of_state, np.eye(RIG_CONSTANTS)]), np.ones(NORMAL_BINS, dtype=np.bool_)
    answer = improvement(outline, covariance, spread=spread, touched=everywhere)
    true = np.where(np.arange(RIG_CONSTANTS) == R.STANDOFF, 2e-4, 0.0)
    assert led_astray(answer, true) == pytest.approx(6.0, rel=1e-6)
    assert led_astray(answer, np.roll(true, 1)) == 0.0


def test_named_in_time_is_within_ten_seconds_of_being_led_astray():
    row = ExploredRow("φ2 1°", "rig", 3, astray_s=5.0, named_s=14.9, verdicts=(3, 0, 0, 5))
    late, never = replace(row, named_s=15.1), replace(row, named_s=math.nan)
    assert [each.in_time for each in (row, late, never)] == [True, False, False]
    clean = ExploredRow("nothing", "rig", 4, verdicts=(0, 0, 1, 7))
    text = report([row, late, never, clean, replace(clean, verdicts=(0, 0, 0, 8)), replace(clean, error="lost")])
    assert "1 of 3 led astray by more than 3 sd have the right name, alone, within 10 s" in text
    assert "1 of 2 with nothing off have a name" in text
    assert "nothing, rig 4: lost" in text


def test_a_run_begins_explores_and_counts_its_answers(monkeypatch):
    row = off_explored.run(ExploredTask("pad 1's zero 0.3 mm", "friction", 3, 1.5))
    assert row.error == ""
    assert len(row.verdicts) == len(VERDICTS)
    assert row.verdicts[:3] == (0, 0, 0), "named before anything is beyond question"
    monkeypatch.setattr(off_explored, "Wireless", lambda *_, **__: 1 / 0)
    assert off_explored.run(ExploredTask(CAN_BE_OFF[0], "rig", 3)).error == "ZeroDivisionError: division by zero"
