"""Files that are not read here, known by their first bytes: what they are, and what to do with them."""

from pathlib import Path

from millcal.errors import RecordingError

_ARCHIVE = "unpack it first"
_AS_TEXT = "export it as text (CSV) from the program that wrote it"
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
    (b"RIFF", "a WAV file", _LATER),
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
    suffix = path.suffix.lower()
    if suffix == ".dwd" and b"\x00" in head[:4096]:
        raise RecordingError(
            f"{path}: a binary DynoWare file (.dwd), which is undocumented; export it as text in DynoWare"
        )
