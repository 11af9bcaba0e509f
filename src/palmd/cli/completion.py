"""Prints the shell completion script for palmd's commands, options and files.

bash: `source <(palmd install completion bash)` in ~/.bashrc. zsh: `eval "$(palmd install completion zsh)"` in ~/.zshrc,
after `compinit`. `palmd install completion man` prints the path of the manual page, for `man -l`.
"""

from __future__ import annotations

import argparse

from palmd.console.shipped import shipped

SHELLS = ("bash", "zsh")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's arguments."""
    parser.add_argument("shell", choices=(*SHELLS, "man"), help="the shell, or man: print the path of the manual page")


def run(arguments: argparse.Namespace) -> int:
    """Print the script, or the path of the manual page."""
    if arguments.shell == "man":
        print(shipped("shell/palmd.1"))
    else:
        print(shipped(f"shell/palmd.{arguments.shell}").read_text(encoding="utf-8"), end="")
    return 0
