"""`palmd record bundle`: what the zip contains, and what it leaves out."""

import zipfile

import pytest

from palmd.cli import main
from palmd.console.redaction import REMOVED, redacted

KEY = "rq:rM>}U?@Lns47E1%kR.o@n%FcmmsL/@{H8]yf7"
PORT = "port: /dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A1-if00"
HASH = "config_hash: 9f86d081884c7d659a2feaa0c55ad015a3bf4f1b"


def test_a_bundle_has_run_configuration_versions_and_findings_without_secrets(tmp_path, capsys):
    run, config, output = tmp_path / "run.jsonl", tmp_path / "palmd.yaml", tmp_path / "out.zip"
    run.write_text('{"palmd_log":1,"rig":{}}\n', encoding="utf-8")
    config.write_text(f"# token: sesame\n# {KEY}\nbus: {{keys: /home/ann/keys}}\n", encoding="utf-8")
    assert main(["bundle", str(run), "--config", str(config), "-o", str(output)]) == 0
    with zipfile.ZipFile(output) as bundle:
        texts = {name: bundle.read(name).decode() for name in bundle.namelist()}
    assert set(texts) == {"run.jsonl", "palmd.yaml", "versions.txt", "doctor.txt"}
    assert texts["run.jsonl"] == run.read_text()
    assert "palmd 0." in texts["versions.txt"]
    assert "numpy" in texts["versions.txt"]
    assert "python" in texts["doctor.txt"]
    whole = "".join(texts.values())
    for secret in ("sesame", KEY, "/home/ann"):
        assert secret not in whole
    assert str(output) in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("password: hunter2", f"password: {REMOVED}"),
        ("{api_key: abc, port: /dev/x}", f"{{api_key: {REMOVED}, port: /dev/x}}"),
        ("tcp://ann:pw@host:1", f"tcp://{REMOVED}@host:1"),
        ("counts_per_mm: 7.874", "counts_per_mm: 7.874"),
        (PORT, PORT),
        (HASH, HASH),
        ("plan: /home/ann/rig/plans", "plan: ~/rig/plans"),
    ],
)  # fmt: skip
def test_only_secrets_are_removed(text, expected):
    assert redacted(text) == expected
