"""An argument parser that refuses in one sentence and proposes the nearest word that it knows."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from nmt_core.text.proposal import did_you_mean

EXIT_DONE, EXIT_FAILED, EXIT_USER, EXIT_PARTLY, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


class CommandRefusal(SystemExit):
    """The end of a command whose words were refused.

    Attributes:
        sentence: what is wrong.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(EXIT_USER)
        self.sentence = sentence


class CommandParser(argparse.ArgumentParser):
    """Refuses with one sentence and exit code 2; unknown words get a proposal."""

    _words: Sequence[str] = ()

    def error(self, message: str) -> NoReturn:
        """Say what is wrong and end; an option that does not exist is the first cause of other errors.

        Raises:
            Refusal: always.
        """
        message = next((self._unknown(word) for word in self._words if self._is_unknown(word)), message)
        sentence = message[:1].upper() + message[1:].rstrip(".")
        sys.stderr.write(f"{self.prog}: {sentence}; see '{self.prog} --help'.\n")
        raise CommandRefusal(sentence + ".")

    def parse_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> argparse.Namespace:
        """As :meth:`argparse.ArgumentParser.parse_args`; a word that no option has is named with the nearest one."""
        arguments, unknown = self.parse_known_args(args, namespace)
        if unknown:
            parser = _chosen(self, arguments)
            word = next((text for text in unknown if text.startswith("-")), unknown[0])
            parser.error(parser._unknown(word) if isinstance(parser, CommandParser) else f"unknown argument {word!r}")
        return arguments

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """As :meth:`argparse.ArgumentParser.parse_known_args`."""
        parts = any(isinstance(action, argparse._SubParsersAction) for action in self._actions)
        self._words = () if parts else tuple(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def _is_unknown(self, word: str) -> bool:
        """Whether a word is a long option that is none of this command, nor short for one."""
        name = word.partition("=")[0]
        return name.startswith("--") and name != "--" and not any(word.startswith(name) for word in _option_words(self))

    def _unknown(self, word: str) -> str:
        name = word.partition("=")[0]
        proposal = did_you_mean(name, _option_words(self)) if name.startswith("-") else ""
        return f"unknown argument {word!r}{proposal}"

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices and isinstance(value, str):
            known = [str(choice) for choice in action.choices]
            raise argparse.ArgumentError(
                action, f"there is no {value!r}, only {', '.join(known)}{did_you_mean(value, known)}"
            )
        super()._check_value(action, value)


def leaf_parsers(parser: argparse.ArgumentParser) -> list[argparse.ArgumentParser]:
    """The parsers that take a command's options: its parts where it has parts, else itself."""
    parts = next((action for action in parser._actions if isinstance(action, argparse._SubParsersAction)), None)
    if parts is None:
        return [parser]
    return [leaf for part in parts.choices.values() for leaf in leaf_parsers(part)]


def _chosen(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> argparse.ArgumentParser:
    """The parser of the command, or of its part, that was asked for."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            chosen = action.choices.get(str(getattr(arguments, action.dest, "")))
            return parser if chosen is None else _chosen(chosen, arguments)
    return parser


def _option_words(parser: argparse.ArgumentParser) -> list[str]:
    return [word for action in parser._actions for word in action.option_strings]
