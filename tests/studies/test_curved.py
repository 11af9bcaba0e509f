"""The study of logs of curved palms: its table."""

from tools.studies.curved import STUDY, LogRow


def test_the_table_tells_right_rejected_and_wrong_apart():
    rows = [
        LogRow("cradle", 0, 10.0, "", True, "", 1.0, 2.0, 5e-6, 1.0, 0.3),
        LogRow("cradle", 1, 10.0, "", True, "", 1.0, 2.0, 4e-4, 9.0, 0.3),
        LogRow("cradle", 2, 10.0, "", False, "the readings tell too little", 1.0, 2.0, 5e-6, 1.0, 0.3),
        LogRow("dome", 0, 10.0, "ValueError: no"),
    ]
    head, cradle, dome, everything = (line.split() for line in STUDY.tabled(rows).splitlines())
    assert head[:4] == ["runs", "right", "rejected", "wrong"]
    assert cradle[:5] == ["cradle", "3", "1", "1", "1"]
    assert dome[:5] == ["dome", "1", "0", "1", "0"]
    assert everything[:5] == ["all", "4", "1", "2", "1"]
    assert list(STUDY.remarks(rows)) == ["cradle 2: the readings tell too little", "dome 0: ValueError: no"]
