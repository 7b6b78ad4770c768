"""Sound as WAV files hold it: whole numbers or floats, any number of channels, uncompressed.

A WAV file says how many samples a second and how many bits, and nothing of pascals: its numbers are shares of the full scale
(FS) of the recorder, and are left so unless a unit is stated. Only the headers are read at once; any part of the samples is read
when it is asked for, so that an hour of a telephone's recording costs no memory.

References
----------
IBM, Microsoft 1991, Multimedia Programming Interface and Data Specifications 1.0 (RIFF, WAVE_FORMAT_PCM).
EBU Tech 3306 (RF64: sizes beyond 4 GB).
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from millcal.data import Notice
from millcal.errors import RecordingError
from millcal.io.formats.hdf5 import blocks_of
from millcal.io.formats.source import Column, Source

PCM, FLOAT, EXTENSIBLE = 0x0001, 0x0003, 0xFFFE
COMPRESSED = {0x0002: "ADPCM", 0x0006: "A-law", 0x0007: "mu-law", 0x0011: "ADPCM", 0x0050: "MPEG", 0x0055: "MP3"}
UNKNOWN_SIZE = 0xFFFFFFFF  # by programs that write to a pipe, and in RF64, which says it elsewhere
BYTE_MIDDLE = 128  # numbers of one byte have no sign: this is silence
_DAMAGED = "copy the file again, or save the sound as WAV (PCM) once more"


class Layout(NamedTuple):
    """How samples lie in the file."""

    code: int  # PCM or FLOAT
    channels: int
    rate: int  # Hz
    width: int  # bytes of one number
    offset: int  # byte of the first sample
    length: int  # samples of one channel


def sniff(path: Path, head: bytes) -> bool:
    """A RIFF or RF64 file of waves."""
    return head[:4] in (b"RIFF", b"RF64") and head[8:12] == b"WAVE"


def open_source(path: Path, setup: Any = None) -> Source:
    """Open a WAV file: channels `sound`, or `sound1`, `sound2`, .. of several, in shares of full scale."""
    notices: list[Notice] = []
    with open(path, "rb") as file:
        layout = _layout(path, file, notices)
    names = ["sound"] if layout.channels == 1 else [f"sound{i + 1}" for i in range(layout.channels)]

    def read_rows(start: int, stop: int, rows: Sequence[int]) -> np.ndarray:
        return _values(path, layout, start, stop)[list(rows)]

    def read_block(start: int, stop: int) -> np.ndarray:
        return _values(path, layout, start, stop)

    return Source(
        path=path,
        format="wav",
        columns=tuple(Column(name, unit="FS", written=name, full_scale=1.0) for name in names),
        blocks=lambda progress: blocks_of(read_block, layout.length, progress),
        rows=layout.length,
        read_block=read_block,
        read_rows=read_rows,
        sample_rate=float(layout.rate),
        place=lambda row: f"sample {row}",
        notices=notices,
        details={"bits": 8 * layout.width, "numbers": "float" if layout.code == FLOAT else "whole"},
    )


def _layout(path: Path, file: BinaryIO, notices: list[Notice]) -> Layout:
    """Where the samples are and what they are, from the chunks before them."""
    size = file.seek(0, 2)
    file.seek(12)
    wide: int | None = None  # bytes of samples, by the header of RF64
    form: tuple[int, int, int, int] | None = None
    while True:
        start = file.tell()
        head = file.read(8)
        if len(head) < 8:
            what = "cut short before its samples begin" if form else "damaged: it does not say what its samples are"
            raise RecordingError(f"{path}: a WAV file that is {what}; {_DAMAGED}")
        name, length = struct.unpack("<4sI", head)
        if name == b"ds64" and length >= 16:
            wide = struct.unpack("<8xQ", _read(path, file, 16))[0]
        elif name == b"fmt ":
            form = _form(path, _read(path, file, length) if length <= 4096 else b"")
        elif name == b"data":
            break
        file.seek(start + 8 + length + length % 2)  # chunks begin at even places
    if form is None:
        raise RecordingError(f"{path}: a WAV file that is damaged: it does not say what its samples are; {_DAMAGED}")
    code, channels, rate, width = form
    offset, frame = file.tell(), channels * width
    said = wide if wide is not None and length == UNKNOWN_SIZE else length
    there = size - offset
    if said > there and said < UNKNOWN_SIZE - 8 * frame:  # else it was written to a pipe, which knows no end
        lost = (said - there) / (frame * rate)
        message = f"the file is cut short: {there / (frame * rate):.4g} s are there, and {lost:.4g} s that it speaks of are not"
        notices.append(Notice("cut-short", message, str(path)))
    return Layout(code, channels, rate, width, offset, min(said, there) // frame)


def _form(path: Path, chunk: bytes) -> tuple[int, int, int, int]:
    """Kind of number, channels, rate and bytes of one number."""
    if len(chunk) < 16:
        raise RecordingError(f"{path}: a WAV file that is damaged: its format is cut short; {_DAMAGED}")
    code, channels, rate, _, frame, bits = struct.unpack("<HHIIHH", chunk[:16])
    if code == EXTENSIBLE and len(chunk) >= 26:
        code = struct.unpack("<H", chunk[24:26])[0]
    if code not in (PCM, FLOAT):
        what = COMPRESSED.get(code, f"format {code:#06x}")
        raise RecordingError(f"{path}: a WAV file of compressed sound ({what}); save it as WAV (PCM)")
    if channels < 1 or rate < 1 or frame % channels or frame == 0:
        raise RecordingError(
            f"{path}: a WAV file that is damaged: {channels} channels, {rate} samples per second, {frame} bytes for each; "
            f"{_DAMAGED}"
        )
    width = frame // channels
    if bits > 8 * width or width not in ((1, 2, 3, 4) if code == PCM else (4, 8)):
        raise RecordingError(f"{path}: a WAV file with numbers of {bits} bits; save it as WAV with 16, 24 or 32 bits")
    return code, channels, rate, width


def _read(path: Path, file: BinaryIO, length: int) -> bytes:
    found = file.read(length)
    if len(found) < length:
        raise RecordingError(f"{path}: a WAV file that is cut short before its samples begin; {_DAMAGED}")
    return found


def _values(path: Path, layout: Layout, start: int, stop: int) -> np.ndarray:
    """Samples start..stop.   returns (channel, stop - start), of full scale"""
    start, stop, _ = slice(start, stop).indices(layout.length)
    frame = layout.channels * layout.width
    with open(path, "rb") as file:
        file.seek(layout.offset + start * frame)
        raw = np.frombuffer(file.read(max(stop - start, 0) * frame), np.uint8)
    if len(raw) < max(stop - start, 0) * frame:
        raise RecordingError(f"{path}: has become shorter while it was read; {_DAMAGED}")
    if layout.code == FLOAT:
        values = raw.view(f"<f{layout.width}").astype(np.float64)
    elif layout.width == 1:
        values = raw.astype(np.float64) / BYTE_MIDDLE - 1
    else:  # the highest bytes of a whole number of 32 bits: 24 bits have no type of their own
        whole = np.zeros((len(raw) // layout.width, 4), np.uint8)
        whole[:, 4 - layout.width :] = raw.reshape(-1, layout.width)
        values = whole.view("<i4")[:, 0].astype(np.float64) / 2**31
    return values.reshape(-1, layout.channels).T.copy()
