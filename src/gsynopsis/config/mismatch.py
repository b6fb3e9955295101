"""Messages of msgspec about values of other types, in the words of our errors."""

from dataclasses import dataclass

import msgspec

NO_NUL = r"^[^\x00]*\Z"
"""Of names of files and folders: none has a NUL."""


@dataclass(frozen=True)
class Mismatch:
    """A value that is not of its type: dotted name, what it is if that is said, what it should be.

    The name is empty where the whole is meant.
    """

    name: str
    found: str | None
    expected: str


def mismatch(error: msgspec.ValidationError) -> Mismatch:
    """As ``Expected `int`, got `str` - at `$.model.slots` `` says it."""
    text, _, place = str(error).partition(" - at ")
    name = place.strip("`").removeprefix("$").removeprefix(".")
    said = text.replace("`", "")
    if said.startswith("Expected "):
        expected, _, found = said.removeprefix("Expected ").partition(", got ")
        if "matching regex" in expected:
            return Mismatch(name, "a NUL", "a name")
        return Mismatch(name, found or None, expected)
    return Mismatch(name, said[:1].lower() + said[1:], "")
