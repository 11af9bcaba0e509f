"""The study of logs of curved palms: its table."""

from tools.studies.curved import LogRow, log_table


def test_the_table_tells_right_refused_and_wrong_apart():
    rows = [
        LogRow("cradle", 0, "", True, "", 5e-6, 1.0, 0.3, 1.0, 2.0),
        LogRow("cradle", 1, "", True, "", 4e-4, 9.0, 0.3, 1.0, 2.0),
        LogRow("cradle", 2, "", False, "the readings tell too little", 5e-6, 1.0, 0.3, 1.0, 2.0),
        LogRow("dome", 0, "ValueError: no"),
    ]
    head, cradle, dome, everything = (line.split("  ") for line in log_table(rows).splitlines())
    assert [cell.strip() for cell in head if cell.strip()][:4] == ["runs", "right", "refused", "wrong"]
    assert [cell.strip() for cell in cradle if cell.strip()][:5] == ["cradle", "3", "1", "1", "1"]
    assert [cell.strip() for cell in dome if cell.strip()][:5] == ["dome", "1", "0", "1", "0"]
    assert [cell.strip() for cell in everything if cell.strip()][:5] == ["all", "4", "1", "2", "1"]
