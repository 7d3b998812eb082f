"""One file per encoding of EventPacket: each defines ENCODING (its name) and DECODER."""
