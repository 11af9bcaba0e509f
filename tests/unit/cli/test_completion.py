"""Completion in a real bash, and the manual page: both know every command of the table."""

from __future__ import annotations

import inspect
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from palmd.cli import completion, main
from palmd.cli.table import COMMANDS, subcommands
from palmd.console.shipped import shipped


def completed(*words: str) -> list[str]:
    """Bash's completions of the last word."""
    program = (
        f"source {shipped('shell/palmd.bash')}\n"
        f"COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1}\n"
        "_shtab_palmd palmd\n"
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=False)
    return done.stdout.split()


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_bash_completes_commands_options_and_choices() -> None:
    assert set(completed("palmd", "rec")) == {"record", "reconstruct", "recognise"}
    assert "latency" in completed("palmd", "doctor", "la")
    assert completed("palmd", "ctl", "explore", "--cov") == ["--coverage"]
    assert set(completed("palmd", "calibrate", "pa")) == {"pad", "pads"}
    assert set(completed("palmd", "ctl", "st")) == {"status", "start", "stop"}
    assert completed("palmd", "check", "--dr") == ["--draw"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="there is no zsh")
def test_the_zsh_command_from_the_help_works() -> None:
    quoted = re.search(r'`eval "\$\((palmd install completion zsh)\)"`', inspect.getdoc(completion) or "")
    assert quoted
    program = (
        "autoload -U compinit; compinit -u -D\n"
        f'palmd() {{ {sys.executable} -m palmd "$@" }}\n'
        f'eval "$({quoted.group(1)})"\n'
        "print -r -- ${_comps[palmd]} $+functions[_shtab_palmd]"
    )
    done = subprocess.run(["zsh", "-f", "-c", program], capture_output=True, text=True, check=False)
    assert (done.stdout.split(), done.stderr) == (["_shtab_palmd", "1"], "")


def test_the_manual_page_lists_every_command(capsys) -> None:
    assert main(["install", "completion", "man"]) == 0
    page = Path(capsys.readouterr().out.strip()).read_text()
    listed = set(re.findall(r"^\.SS palmd (.*)$", page, re.MULTILINE))
    assert listed == {each.name for each in COMMANDS if each.module} - {"report paper"}


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_the_script_is_printed(shell: str, capsys) -> None:
    assert main(["install", "completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(name in script for name in subcommands())
