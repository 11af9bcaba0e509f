"""Prints what has a shell complete palmd's commands, options and files; each session sources it.

bash: `source <(palmd install completion bash)` in ~/.bashrc. zsh: `eval "$(palmd install completion zsh)"` in ~/.zshrc,
after `compinit`. The manual page lies beside these files: `palmd install completion man` prints where, for `man -l`.
"""

from __future__ import annotations

import argparse

from palmd.console.shipped import shipped

SHELLS = ("bash", "zsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("shell", choices=(*SHELLS, "man"), help="which shell; or man: where the manual page is")


def run(arguments: argparse.Namespace) -> int:
    """Prints the script, or the path of the manual page."""
    if arguments.shell == "man":
        print(shipped("shell/palmd.1"))
    else:
        print(shipped(f"shell/palmd.{arguments.shell}").read_text(encoding="utf-8"), end="")
    return 0
