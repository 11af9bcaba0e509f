"""A jog from a client's side: a refusal midway reports how far the jog has come."""

from palmd.bus.jogging import jog


class Refusing:
    """A daemon that accepts a number of steps and refuses the next one."""

    def __init__(self, taken):
        self.left = taken

    def ask(self, command, args):
        assert (command, "phi2_deg" in args) == ("jog", True)
        self.left -= 1
        return {"ok": True} if self.left >= 0 else {"ok": False, "error": "not now"}


def test_a_jog_refused_at_its_first_step_reports_no_motion():
    assert jog(Refusing(0), {"phi2_deg": -2.0}) == {"ok": False, "error": "not now"}


def test_a_jog_refused_midway_reports_how_far_it_has_come():
    reply = jog(Refusing(3), {"phi1_deg": 0.0, "phi2_deg": -2.0})
    assert not reply["ok"]
    assert "phi2_deg -1.2 of -2" in reply["error"]
    assert "phi1_deg" not in reply["error"]
    assert "not now" in reply["error"]
