"""Messages in tests of which only the header counts."""

import struct

MS = 1_000_000


def message(stamp_ms: float, order: str = "<", rest: bytes = b"") -> bytes:
    """Serialise a header's stamp as CDR in an order of bytes, with something behind it."""
    seconds, nanoseconds = divmod(round(stamp_ms * MS), 1000 * MS)
    encapsulation = b"\0\1\0\0" if order == "<" else b"\0\0\0\0"
    return encapsulation + struct.pack(f"{order}iI", seconds, nanoseconds) + rest
