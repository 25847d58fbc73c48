"""``./nmt completion``: what bash and zsh need to complete commands, options and rigs."""

from __future__ import annotations

import sys
from dataclasses import dataclass

from nmt_core.errors import BenchError
from nmt_core.options import argument


@dataclass(frozen=True, kw_only=True)
class CompletionOptions:
    """Prints a script that lets the shell complete commands and options with the tabulator key. bash: eval "$(./nmt
    completion bash)" in ~/.bashrc, with the launcher's full path. zsh: the same with zsh, after compinit, in
    ~/.zshrc."""

    shell: str = argument("for which shell", choices=("bash", "zsh"))


def run(options: CompletionOptions) -> int:
    """Print the script.

    Raises:
        BenchError: the library that writes it is not installed.
    """
    from nmt_bench.cli import all_commands, build_parser

    try:
        import shtab
    except ModuleNotFoundError as error:
        raise BenchError(
            "'shtab' is not installed; type in a clone of the bench: pip install '.[completion]'."
        ) from error
    parser = build_parser(*all_commands())
    parser.prog = "nmt"
    sys.stdout.write(shtab.complete(parser, options.shell) + "\n")
    if options.shell == "bash":  # the launcher is called by its path
        sys.stdout.write("complete -o filenames -F _shtab_nmt ./nmt\n")
    return 0
