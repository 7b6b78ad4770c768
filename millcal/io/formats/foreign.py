"""Files that are not read here, known by their first bytes: what they are, and what to do with them."""

from pathlib import Path

from millcal.errors import RecordingError

_ARCHIVE = "unpack it first"
_AS_TEXT = "export it as text (CSV) from the program that wrote it"
_UNPACKED = "save the sound as WAV (PCM), or record it so"
_LATER = "this format is not yet read; export it as CSV or HDF5"
MAGIC = (  # first bytes, what it is, what to do
    (b"PK\x03\x04", "a zip archive or a spreadsheet (xlsx)", "unpack it, or save the sheet as CSV"),
    (b"PK\x05\x06", "an empty zip archive", _ARCHIVE),
    (b"\x1f\x8b", "a gzip archive", _ARCHIVE),
    (b"BZh", "a bzip2 archive", _ARCHIVE),
    (b"\xfd7zXZ", "an xz archive", _ARCHIVE),
    (b"7z\xbc\xaf", "a 7z archive", _ARCHIVE),
    (b"Rar!", "a rar archive", _ARCHIVE),
    (b"\xd0\xcf\x11\xe0", "an old spreadsheet (xls) or another Office file", "save the sheet as CSV"),
    (b"TDSm", "a TDMS file", _LATER),
    (b"MATLAB 5.0", "a MAT file", "this format is not yet read; save it with -v7.3 and name the datasets in a setup, or as CSV"),
    (b"ID3", "compressed sound (MP3)", _UNPACKED),
    (b"\xff\xfb", "compressed sound (MP3)", _UNPACKED),
    (b"fLaC", "compressed sound (FLAC)", _UNPACKED),
    (b"OggS", "compressed sound (Ogg)", _UNPACKED),
    (b"#!AMR", "compressed sound (AMR)", _UNPACKED),
    (b"caff", "a CAF sound file", _UNPACKED),
    (b"RIFX", "a WAV file of the other byte order", _UNPACKED),
    (b"\x93NUMPY", "a NumPy file", _LATER),
    (b"PAR1", "a Parquet file", _LATER),
    (b"SQLite format 3", "a database", _AS_TEXT),
    (b"%PDF", "a PDF document", "give the recording itself"),
    (b"\x89PNG", "a picture", "give the recording itself"),
    (b"\xff\xd8\xff", "a picture", "give the recording itself"),
)  # fmt: skip


def refuse_foreign(path: Path, head: bytes) -> None:
    """Say what a file is that millcal does not read; return if it may be one that it reads."""
    for magic, what, mending in MAGIC:
        if head.startswith(magic):
            raise RecordingError(f"{path}: {what}; {mending}")
    if head[4:8] == b"ftyp":
        raise RecordingError(f"{path}: compressed sound or a film (m4a, mp4); {_UNPACKED}")
    if head[:4] == b"FORM" and head[8:12] in (b"AIFF", b"AIFC"):
        raise RecordingError(f"{path}: an AIFF sound file; {_UNPACKED}")
    if head.startswith(b"RIFF") and head[8:12] != b"WAVE":
        what = "a film (AVI)" if head[8:12] == b"AVI " else "a RIFF file without sound, or cut short"
        raise RecordingError(f"{path}: {what}; {_UNPACKED}")
    suffix = path.suffix.lower()
    if suffix == ".wav" and b"\x00" in head and head[:4] not in (b"RIFF", b"RF64", b"\x89HDF"):
        raise RecordingError(f"{path}: no WAV file, though it is named so; {_UNPACKED}")
    if suffix == ".dwd" and b"\x00" in head[:4096]:
        raise RecordingError(
            f"{path}: a binary DynoWare file (.dwd), which is undocumented; export it as text in DynoWare"
        )
