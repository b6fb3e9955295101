"""Messages of msgspec about values of other types, in the words of our errors."""

from dataclasses import dataclass

import msgspec

NO_NUL = r"^[^\x00]*\Z"
"""Of names of files and folders: none has a NUL."""


@dataclass(frozen=True)
class Mismatch:
    """A value that is not of its type.

    Attributes:
        name: Dotted; empty where the whole is meant.
        found: Its type, if that is said.
        expected: Its type, or what is wrong.
        text: All of it in one sentence.
    """

    name: str
    found: str | None
    expected: str
    text: str


def mismatch(error: msgspec.ValidationError) -> Mismatch:
    """As ``Expected `int`, got `str` - at `$.model.slots` `` says it."""
    text, _, place = str(error).partition(" - at ")
    if "matching regex" in text:
        text = "Expected `a name`, got `a NUL`"
    name = place.strip("`").removeprefix("$").removeprefix(".")
    expected, _, found = text.replace("`", "").removeprefix("Expected ").partition(", got ")
    return Mismatch(name, found or None, expected, text[:1].lower() + text[1:])
