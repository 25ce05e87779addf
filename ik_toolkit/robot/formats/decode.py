"""Decodes the bytes of an XML file to text, by its byte order mark or by the encoding that it declares."""

import codecs
import re

from ...errors import ModelError

MARKS = (  # Byte order marks. UTF-32 comes first because its mark begins with that of UTF-16.
    (codecs.BOM_UTF32_LE, "utf-32"), (codecs.BOM_UTF32_BE, "utf-32"), (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"),
    (b"<\0?\0", "utf-16-le"), (b"\0<\0?", "utf-16-be"),
)  # fmt: skip
# The encoding names windows-31j and x-sjis occur in files, but Python does not know them.
ALIASES = {"windows-31j": "cp932", "x-sjis": "shift_jis"}
DECLARED = re.compile(r"""\A(\s*<\?xml[^>]*?)\s+encoding\s*=\s*["']([^"'>]*)["']""")
# TEXTS has the encodings of text that Python decodes in time proportional to the input.
# TEXTS has no codec that unpacks data, such as zip or hex.
TEXTS = re.compile(
    r"utf-8|ascii|iso8859-\d+|cp(125\d|437|85\d|866|932|936|949|950|1361)|koi8-[rtu]|mac-(roman|cyrillic|greek|latin2)|"
    r"shift_jis(_2004|x0213)?|euc_(jp|kr|jis_2004|jisx0213)|iso2022_(jp|kr)(_\w+)?|gb2312|gbk|gb18030|hz|big5(hkscs)?|"
    r"johab|tis-620|ptcp154|kz1048"
)


def decode(raw: bytes, name: str) -> str:
    """Decode a file and return its text, without an encoding in the XML declaration.

    The name of the file appears in error messages. Raises ModelError if the bytes are not text in the encoding found.
    """
    codec = next((codec for mark, codec in MARKS if raw.startswith(mark)), None)
    head = DECLARED.match(raw[:1024].decode("latin-1")) if codec is None else None
    codec = codec or (_codec(head[2]) if head else "utf-8")
    try:
        text = raw.decode(codec)
    except UnicodeDecodeError as error:
        lost = (
            f" and declares '{head[2][:40]}', which is not read" if head and head[2].lower() != codec == "utf-8" else ""
        )
        what = "UTF-8" if codec.startswith("utf-8") else codec
        raise ModelError(f"'{name}' is not {what} text (byte {error.start}){lost}; save it as UTF-8") from None
    if "\0" in text:
        raise ModelError(f"'{name}' is not UTF-8 text (it has NUL bytes); save it as UTF-8")
    return undeclared(text)


def undeclared(text: str) -> str:
    """Remove an encoding other than UTF-8 from an XML declaration, so that no later reader decodes the text again."""
    head = DECLARED.match(text[:1024])
    return text if head is None or head[2].lower() == "utf-8" else head[1] + text[head.end() :]


def _codec(declared: str) -> str:
    """Return Python's codec for a declared encoding, or UTF-8 if the declared one is not in TEXTS.

    UTF-8 may be right even if UTF-16 is declared, because a declaration that could be read is not in UTF-16.
    """
    try:
        codec = codecs.lookup(ALIASES.get(declared.lower(), declared)).name if declared.isascii() else ""
    except (LookupError, ValueError):
        codec = ""
    return codec if TEXTS.fullmatch(codec) else "utf-8"
