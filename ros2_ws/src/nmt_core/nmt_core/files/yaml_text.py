"""YAML as text, by libyaml where PyYAML has it: a tenth of the time of PyYAML's own emitter."""

from __future__ import annotations

from typing import Any

import yaml

from nmt_core.files.hardened import BoundedYaml

_Dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


class _PlainDumper(_Dumper):  # type: ignore[misc]
    """Without anchors: the YAML parsers of others need not know them."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


# A text that either YAML 1.1 or the bench's reader takes for a number is quoted.
_PlainDumper.yaml_implicit_resolvers = {
    letter: [*_Dumper.yaml_implicit_resolvers.get(letter, ()), *resolvers]
    for letter, resolvers in BoundedYaml.yaml_implicit_resolvers.items()
}


def yaml_text(value: Any, sort_keys: bool = False, ascii_only: bool = False) -> str:
    """Text that ``yaml.safe_load`` reads as `value`; without anchors.

    Args:
        value: of plain types: mappings, lists, texts, numbers, truth values, None.
        sort_keys: keys of mappings in alphabetical order instead of as given.
        ascii_only: escape all other characters.

    Raises:
        yaml.YAMLError: a value of another type.
    """
    return str(yaml.dump(value, Dumper=_PlainDumper, sort_keys=sort_keys, allow_unicode=not ascii_only))
