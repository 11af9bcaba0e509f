"""The table of errata: each witness shows what it claims, and no wrong equation is missing."""

from __future__ import annotations

import pytest

from tools.studies.equations import errata, paper

ERRATA = errata.errata()


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda one: one.claim.equation)
def test_the_witness_tells_printed_from_right(erratum: errata.Erratum) -> None:
    printed, derived, corrected = erratum.witness()
    assert abs(printed - derived) > 1e-3 * abs(derived)
    assert corrected == pytest.approx(derived, rel=1e-9)


@pytest.mark.parametrize("erratum", ERRATA, ids=lambda one: one.claim.equation)
def test_what_is_printed_and_what_is_right_read_differently(erratum: errata.Erratum) -> None:
    assert erratum.printed != erratum.correct
    assert "|" not in erratum.printed + erratum.correct, "it would break the page's table"


def test_the_witness_is_an_ordinary_state() -> None:
    w = errata.WITNESS
    assert set(paper.POINT) <= set(w)
    assert min(abs(w["omega1"] - w["omega0"]), abs(w["omega1"] + w["omega2"] - w["omega0"])) > 0.5
    assert w["phi1"] + w["phi2"] < 3.0


def test_they_are_in_the_papers_order_and_each_wrong_claim_stands_once() -> None:
    equations = [one.equation for one in ERRATA]
    assert equations == sorted(equations)
    claims = [one.claim.equation for one in ERRATA]
    assert len(set(claims)) == len(claims)
    assert set(claims) <= set(errata.claims())
