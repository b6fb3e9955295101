"""Messages of msgspec about values of other types, in the words of our errors."""

from dataclasses import dataclass

import msgspec

NO_NUL = r"^[^\x00]*\Z"
"""Pattern for names of files and folders: any text without a NUL."""


@dataclass(frozen=True)
class Mismatch:
    """A value of the wrong type.

    Attributes:
        name: Dotted name of the setting; empty for the document as a whole.
        found: Type found, if msgspec names it.
        expected: Type expected, or the fault.
        text: The whole message in one sentence.
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
