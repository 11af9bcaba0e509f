"""The live smoother while contacts slip faster than the palms vibrate, as with an explorer's moves."""

from pathlib import Path

from palmd.config.two_palms import PlanSpec, rig_description
from palmd.events import Improvement
from palmd.observer.incremental import IncrementalSmoother
from palmd.yamlfile import load_config
from tools.closed_loop import TwoPalmsLoop

DEMO = Path(__file__).parents[3] / "config" / "demo.yaml"
SEED, GENTLE_S, ASKED_EVERY_S = 3, 4.2, 0.6
PLAN = PlanSpec.model_validate(
    {
        "name": "fast",
        "segments": [
            {"move": {"phi1_deg": 45, "phi2_deg": 90}, "duration_s": 0.5},
            {"sine": {"phi1_deg": 16, "phi2_deg": 8}, "frequency_hz": [0.7, 0.55], "duration_s": 3.0},
            {"move": {"phi1_deg": 66, "phi2_deg": 48}, "duration_s": 0.85},  # 90 °/s at most
            {"move": {"phi1_deg": 28, "phi2_deg": 112}, "duration_s": 1.3},
        ],
    }
)


class Beside:
    """A smoother that is called now and then; its answers are not used."""

    def __init__(self, rig):
        self.smoother, self.t_ask, self.answers = IncrementalSmoother(rig), 0.0, []

    def submit(self, t, session, events):
        self.smoother.add(session, events)
        if t >= self.t_ask:
            self.t_ask = t + ASKED_EVERY_S
            self.answers.append((t, self.smoother.result()))

    def collect(self, _):
        return None


def test_an_estimate_survives_slip_faster_than_the_vibration():
    config = load_config(DEMO)
    beside = Beside(rig_description(config))
    wireless = TwoPalmsLoop(config, PLAN, SEED, smoothing=beside)
    wireless.start()
    for _ in wireless.run(5.7):
        pass
    found = [isinstance(answer, Improvement) for t, answer in beside.answers if t > GENTLE_S - ASKED_EVERY_S]
    assert wireless.world.contact_losses == 0
    assert len(found) >= 3
    assert all(found)
