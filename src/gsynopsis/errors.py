"""The exception tree. Everything a user can cause ends here, as one clear line.

GsynopsisError
├── InputError            something the user gave cannot be used (exit code 2)
│   ├── SceneError        photos, COLMAP model or transforms.json
│   │   └── NoPosesError        photos without camera poses
│   ├── SettingError      an option, preset or combination of options
│   ├── CheckpointError   a training checkpoint of another scene, setting or version
│   ├── SpaceError        not enough disk or memory for what was asked
│   ├── TraceError        a bandwidth trace that cannot be replayed
│   ├── SourceError       bytes that cannot be had from where they should be
│   │   ├── TransientError      it may work when asked again: busy server, broken connection
│   │   └── ChangedError        the file changed between two requests
│   └── FormatError       a .gsyn file that breaks a promise of docs/format.md
│       ├── NotGsynError        the magic is not ours
│       ├── VersionError        a version or required feature this reader does not know
│       ├── TruncatedError      fewer bytes than promised, or a byte too many
│       ├── ChecksumError       bytes were changed
│       ├── LayoutError         counts, ranges or order that cannot be
│       └── ValueRangeError     non-finite numbers or indices out of range
├── MissingExtraError     an optional part is not installed; names the extra (exit code 2)
├── PeerError             another process of a training by torchrun stopped (exit code 1)
└── DivergedError         training produced a non-finite loss or tensor (exit code 1)
"""

from pathlib import Path

QUOTED = 100
"""Most characters of a file's text that a message repeats."""
WHOLE = 1000
"""Most characters of paths, and of expectations, which are our own text."""


def quoted(value: object, most: int = QUOTED) -> str:
    """The text of a value as a message repeats it: of a long one both ends.

    A file may say megabytes where a word is expected. What another error says is cut already.
    """
    text = str(value)
    if len(text) <= most or isinstance(value, GsynopsisError):
        return text
    return f"{text[: most - most // 3 - 1]}…{text[-(most // 3) :]}"


def printable(text: str) -> str:
    """The same text with escapes for what could steer a terminal or cannot be printed at all."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


class GsynopsisError(Exception):
    """Base of all errors of this package.

    Examples:
        >>> try:
        ...     gs.resolve("best")
        ... except gs.GsynopsisError as error:
        ...     print(error)
        --preset: found best, expected draft or standard or high or max or paper
    """

    exit_code = 1


class InputError(GsynopsisError):
    """Something the user gave cannot be used: a folder, a setting, a file.

    Examples:
        >>> try:
        ...     gs.load_scene("nowhere")
        ... except gs.InputError as error:
        ...     print(error)
        nowhere: found no such folder, expected the folder of a scene
    """

    exit_code = 2

    def __init__(
        self,
        where: Path | str,
        field: str = "",
        *,
        found: object = None,
        expected: object = None,
        advice: str = "",
    ) -> None:
        """One line that names the fault and the remedy.

        Args:
            where: The file, folder or option at fault.
            field: The part of it at fault, empty if the whole.
            found: What stands there.
            expected: What should stand there.
            advice: What to do about it, as a short sentence without a full stop.
        """
        parts = [quoted(where, WHOLE)] + ([quoted(field)] if field else [])
        facts = [] if found is None else [f"found {quoted(found)}"]
        facts += [] if expected is None else [f"expected {quoted(expected, WHOLE)}"]
        tail = ", ".join(facts) + (("; " if facts else "") + advice if advice else "")
        super().__init__(": ".join([*parts, tail]) if tail else ": ".join(parts))
        self.where, self.field, self.found, self.expected = where, field, found, expected
        self.advice = advice


class SceneError(InputError):
    """Photos, COLMAP model or transforms.json cannot be used."""


class NoPosesError(SceneError):
    """There are photos, but nothing that says where their cameras stood."""


class SettingError(InputError):
    """An option, preset or combination of options cannot be used."""


class CheckpointError(InputError):
    """A checkpoint of another scene, setting or version, or a damaged one."""


class SpaceError(InputError):
    """Not enough disk or memory for what was asked."""


class TraceError(InputError):
    """A bandwidth trace is empty, truncated or cannot be replayed."""


class SourceError(InputError):
    """Bytes of a source cannot be read."""


class TransientError(SourceError):
    """A request failed in a way that may go away; what arrived before it is good.

    Attributes:
        after: Seconds that the server asks to wait, 0 if it does not say.
    """

    after: float = 0.0


class ChangedError(SourceError):
    """The file is not the one that earlier requests read."""


class FormatError(InputError):
    """A .gsyn file breaks a promise of docs/format.md.

    Examples:
        >>> from pathlib import Path
        >>> size = Path("broken.gsyn").write_bytes(b"no scene" * 1000)
        >>> try:
        ...     gs.check("broken.gsyn")
        ... except gs.FormatError as error:
        ...     print(type(error).__name__)
        NotGsynError
    """


class NotGsynError(FormatError):
    """The file does not begin with the magic of a .gsyn file."""


class VersionError(FormatError):
    """The file's version or a required feature is not known to this reader."""


class TruncatedError(FormatError):
    """The file has fewer bytes than its header promises, or more."""


class ChecksumError(FormatError):
    """The bytes of a chunk or of the header are not those that were written."""


class LayoutError(FormatError):
    """Counts, ranges or the order of chunks cannot be."""


class ValueRangeError(FormatError):
    """A decoded value is not finite or out of its range."""


class MissingExtraError(GsynopsisError):
    """An optional part is not installed."""

    exit_code = 2

    def __init__(self, what: str, extra: str) -> None:
        """Names the package that is missing and the extra that brings it."""
        super().__init__(f"{what} is not installed; run: pip install 'gsynopsis[{extra}]'")


class PeerError(GsynopsisError):
    """Another process that trains the same model stopped or went away."""


class DivergedError(GsynopsisError):
    """Training produced a value that is not finite."""
