"""Files are written whole or not at all: under a temporary name, then renamed.

An interruption, a full disk or a late error never destroys the existing file.
"""

import csv
import io
import json
import math
import os
import re
import uuid
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from .errors import IKError, InvalidOption, nearest

PARTIAL = ".partial"  # suffix of the file that keeps an incomplete result
# beginning of a cell that a spreadsheet would run as a formula, also with quotes before it
FORMULA = re.compile(r"'*[=+\-@\t\r]")
# The arrays of a file may take UNPACKED bytes plus EXPANSION times the size of the compressed file, so that no small file fills the
# memory; poses compress to a fifth at best.
UNPACKED, EXPANSION = 2**26, 20
NAMES = 2**18  # largest array of joint names that is read from a file [bytes]
NUMBERS, TEXTS = "fiu", "U"  # numpy's letters for the kinds of dtype that are accepted as numbers, and as text
HEADER = 2**16  # largest part of an array read for its header [bytes], as the header is read before any check
JSON_BYTES = 20_000_000  # largest JSON file [bytes]; reading takes 20 times as much memory, and 4 s


def as_path(value: Any, what: str = "it") -> Path:
    """Return a value as a path. Raises InvalidOption, "WHAT must be the path of a file, not VALUE"."""
    if not isinstance(value, str | os.PathLike):
        raise InvalidOption(f"{what} must be the path of a file, not {value!r:.60}")
    return Path(value)


def from_home(path: str | Path) -> Path:
    """Return a path with the home folder in place of a leading ~; one of a user that does not exist stays as it is."""
    return Path(os.path.expanduser(path))  # Path.expanduser raises where there is no such user.


def as_output(value: Any, what: str, *suffixes: str) -> Path:
    """Return the path of a file to write. Raises InvalidOption, "WHAT is written as .a or .b, not .c", for another suffix.

    If there is only one format, a device or pipe (which the shell may name /dev/fd/63) needs no suffix.
    """
    # These suffixes are synonyms: .xml of .urdf, .htm of .html.
    file, formats = as_path(value, "file"), {*suffixes} - {".xml", ".htm"}
    stream = len(formats) == 1 and (file.is_fifo() or file.is_char_device())
    if file.suffix.lower() not in suffixes and not stream:
        named = " or ".join(filter(None, (", ".join(suffixes[:-1]), *suffixes[-1:])))
        raise InvalidOption(f"{what} is written as {named}, not '{file.name}'")
    return file


def require_place(path: str | Path) -> None:
    """Raise InvalidOption if no file can be written at a path, because its folder is missing or not writable."""
    file, place = Path(path), Path(os.path.realpath(path))
    if place.is_dir():
        raise InvalidOption(f"'{file}' is a folder, not a file")
    if file.exists() and not file.is_file():
        return  # A device or a pipe is written directly, without a temporary file.
    missing = next((one for one in reversed(place.parents) if not one.is_dir()), None)
    if missing is not None:
        shown = missing if file.is_absolute() else Path(os.path.relpath(missing))
        if missing.exists():
            raise InvalidOption(f"cannot write '{file}': '{shown}' is a file, not a folder")
        beside = missing.parent
        folders = [one.name for one in beside.iterdir() if one.is_dir()] if os.access(beside, os.R_OK) else []
        close = nearest(missing.name, folders)
        meant = f". Did you mean '{shown.with_name(close)}'?" if close else ""
        raise InvalidOption(f"cannot write '{file}': there is no folder '{shown}'{meant}")
    # the folder must be writable, too, because a temporary file is made in it
    for one in (place, place.parent) if place.is_file() else (place.parent,):
        if not os.access(one, os.W_OK):
            raise InvalidOption(f"cannot write '{file}': no permission to write '{one}'")


class WholeFile:
    """A file that is written under a temporary name and gets its own name when `finish` is called, so that none is half written.

    If the work ends early, the file can be kept under another name, cut off after the last `mark`.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a temporary file next to `path`, or the device or pipe itself. Raises InvalidOption, OSError."""
        require_place(path)
        self.path = Path(path)
        place = Path(os.path.realpath(path))  # A symbolic link is kept; the file it points to is replaced.
        self._place = place if self.path.is_file() or not self.path.exists() else None
        self.part = self.path if self._place is None else place.with_name(f"{place.name}.{uuid.uuid4().hex[:8]}.part")
        self._good = 0
        with self.named():
            self.stream: BinaryIO = self.part.open("wb" if self._place is None else "xb")

    def write(self, data: str | bytes) -> None:
        """Write text (as UTF-8) or bytes, and `mark` the position after them."""
        with self.named():
            self.stream.write(data.encode() if isinstance(data, str) else data)
        self.mark()

    def mark(self) -> None:
        """Mark all that is written so far as complete: `keep` keeps the file up to here if the work ends early."""
        with self.named():
            self.stream.flush()
        if self._place is not None:
            self._good = self.stream.tell()

    def finish(self) -> None:
        """Flush the file to disk and rename it to its final name; if that fails, keep the marked part as NAME.partial."""
        try:
            with self.named():
                self.stream.flush()
                if self._place is not None:
                    os.fsync(self.stream.fileno())
                self.stream.close()
                if self._place is not None:
                    if self._place.exists():
                        os.chmod(self.part, self._place.stat().st_mode & 0o7777)
                    os.replace(self.part, self._place)
        except OSError:
            self.keep(PARTIAL)
            raise

    def keep(self, suffix: str) -> Path | None:
        """Keep the file up to the last `mark`, under its final name plus `suffix`. Returns that path, None if nothing was kept."""
        if self._place is None or not self._good:
            self.drop()
            return None
        kept = self.path.with_name(self.path.name + suffix)
        with suppress(OSError):
            self.stream.close()  # On a full disk this fails once more; the incomplete end is cut off below.
        try:
            os.truncate(self.part, self._good)
            os.replace(self.part, kept)
        except OSError:
            self.drop()
            return None
        return kept

    def drop(self) -> None:
        """Close the file and remove it: nothing of what was written is kept."""
        with suppress(OSError):
            self.stream.close()
        if self._place is not None:
            self.part.unlink(missing_ok=True)

    @contextmanager
    def named(self) -> Iterator[None]:
        """Context manager: errors raised in the `with` block name the requested file instead of the temporary one."""
        try:
            yield
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self.path)) from error


@contextmanager
def whole_file(path: str | Path) -> Iterator[BinaryIO]:
    """Context manager: open a binary stream to a file that gets its name if the block succeeds, and is removed if it fails."""
    file = WholeFile(path)
    try:
        with file.named():
            yield file.stream
        file.finish()
    except BaseException:
        file.drop()
        raise


def write_whole(path: str | Path, data: str | bytes) -> None:
    """Write data to a file whole or not at all; text is written as UTF-8."""
    with whole_file(path) as stream:
        stream.write(data.encode() if isinstance(data, str) else data)


def inert(text: str) -> str:
    """Return text for a cell of a CSV file, with a quote in front if a spreadsheet would run it as a formula."""
    try:
        float(text)  # A number such as -0.5 begins like a formula but is none.
    except ValueError:
        return f"'{text}" if FORMULA.match(text) else text
    return text


def without_mark(text: str) -> str:
    """Return the original text of a CSV cell, without the quote that `inert` puts in front."""
    return text[1:] if text.startswith("'") and FORMULA.match(text) else text


def write_table(path: str | Path, head: list[str], rows: Iterable[Iterable[float | str]]) -> None:
    """Write a table to a CSV file: text, and numbers in full precision; the cell of a NaN is empty."""
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(map(inert, head))
    writer.writerows(["" if x != x else inert(x) if isinstance(x, str) else repr(x) for x in row] for row in rows)
    write_whole(path, text.getvalue())


def _named_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return the entries of a JSON object as a dict. Raises ValueError for a name given twice, of which a dict would lose one."""
    made = dict(pairs)
    if len(made) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"it has {next(name for name in names if names.count(name) > 1)!r:.60} twice")
    return made


def read_json(path: Path, error: type[IKError]) -> Any:
    """Read a JSON file. Raises `error`, which names the file, if it is too large or deep, ValueError if it is no clear JSON."""
    if path.stat().st_size > JSON_BYTES:
        raise error(f"'{path.name}' is larger than {JSON_BYTES / 1e6:.0f} MB; save it as NPZ or CSV")
    try:
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=_named_once)
    except RecursionError:
        raise error(f"'{path.name}': its lists are nested too deep") from None


def why_unread(error: Exception) -> str:
    """Return one line that says why a file could not be read, given the error that reading raised."""
    if isinstance(error, UnicodeDecodeError):
        return f"it is not UTF-8 text (byte {error.start}); save it as UTF-8"
    if isinstance(error, KeyError):
        return f"it lacks {error}"
    text = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
    return " ".join(text.split())[:200] or type(error).__name__


def check_arrays(path: Path, names: Iterable[str], texts: Iterable[str], error: type[IKError]) -> None:
    """Check the headers of an NPZ file before any array of it is read. Raises `error`, which names the file and the array.

    Of the arrays called `names`, those in `texts` hold text, all others real numbers (no dates, complex numbers, truth
    values or objects). No array may declare more bytes than the file holds for it, and together they may take no more than a file
    of this size can hold.
    """
    import numpy as np  # imported here so that `ik --help` stays fast

    packed, together = path.stat().st_size, 0
    with zipfile.ZipFile(path) as archive:
        members = [member for member in archive.infolist() if member.filename.removesuffix(".npy") in names]
        for member in members:
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as stream:
                start = io.BytesIO(stream.read(HEADER))
                version = np.lib.format.read_magic(start)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, dtype = read(start)
            what, kinds = ("names", TEXTS) if name in texts else ("real numbers", NUMBERS)
            if dtype.kind not in kinds:
                raise error(f"'{path.name}': the array {name} holds values of the type {dtype}, not {what}")
            promised = math.prod(shape) * dtype.itemsize
            if promised > member.file_size:
                raise error(
                    f"'{path.name}': {member.filename} declares {promised:,} bytes but holds {member.file_size:,}"
                )
            together += member.file_size
            if name in texts and promised > NAMES:
                raise error(f"'{path.name}': the array {name} takes {promised:,} bytes, too many for names")
            if together > UNPACKED + EXPANSION * packed:
                raise error(
                    f"'{path.name}': {member.filename} unpacks to {together / 1e6:,.1f} MB from {packed / 1e6:,.1f} MB; save it "
                    "with numpy.savez, without compression"
                )
