"""Sets values in the text of a bench file and leaves all other text, including comments,
unchanged.
"""

from __future__ import annotations

import yaml

from rig.common.errors import InputError
from rig.control.motion_words import Change


def patched(text: str, changes: tuple[Change, ...]) -> str:
    """Return the text of a bench file with these values set; a value of None removes its key.

    Raises:
        InputError: A section is not a mapping, so that no key can be set in the section.
    """
    for change in changes:
        text = _set(text, change)
    return text


def _set(text: str, change: Change) -> str:
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    section = next((value for name, value in root.value if name.value == change.section), None)
    if section is None:
        if change.value is None:
            return text
        return f"{text.rstrip()}\n{change.section}: {{{change.key}: {_scalar(change)}}}\n"
    if not isinstance(section, yaml.MappingNode):
        raise InputError(
            f"{change.section}: must consist of keys with values, so that {change} can be set in "
            "this section; correct the section"
        )
    found = next(((n, v) for n, v in section.value if n.value == change.key), None)
    if change.value is None:
        return text if found is None else _without(text, section, *found)
    if found is not None:
        _, value = found
        return text[: value.start_mark.index] + _scalar(change) + text[value.end_mark.index :]
    line = f"{change.key}: {_scalar(change)}"
    if section.flow_style:
        at = section.start_mark.index + 1
        return f"{text[:at]}{line}{', ' if section.value else ''}{text[at:]}"
    first = section.value[0][0].start_mark
    return f"{text[: first.index]}{line}\n{' ' * first.column}{text[first.index :]}"


def _without(text: str, section: yaml.MappingNode, name: yaml.Node, value: yaml.Node) -> str:
    """Return the text without a key of a section."""
    begin, end = name.start_mark.index, value.end_mark.index
    if section.flow_style:
        rest = text[end:]
        ahead = rest.lstrip(", ") if rest.lstrip().startswith(",") else rest
        return text[:begin] + ahead
    if len(section.value) == 1:
        return f"{text[:begin]}{{}}{text[end:]}"
    stop = text.find("\n", end)
    return text[: begin - name.start_mark.column] + (text[stop + 1 :] if stop >= 0 else "")


def _scalar(change: Change) -> str:
    value = change.value
    return f"{value:.12g}" if isinstance(value, float) else str(value)
